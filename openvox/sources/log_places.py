"""Where a log's poses come from: the tree of transforms, or one topic of odometry or poses on top of it."""

from __future__ import annotations

from dataclasses import dataclass, field

from openvox.core.errors import InputError
from openvox.core.types import Pose
from openvox.formats.robot_log import Log, Transform
from openvox.sources.log_topics import Choice, Probe
from openvox.sources.source import Options, read_transform
from openvox.sources.transforms import Tree

WORLDS = ("map", "odom", "world")
"""Names of the map's frame, the likeliest first."""


@dataclass(frozen=True, slots=True)
class Places:
    """Names of frames: the map's, and the one whose pose is taken; and where the depth camera sits in that."""

    world: str
    camera: str
    camera_from_depth: Pose = field(default_factory=Pose.identity)
    topics: frozenset[str] = frozenset()
    """Those of transforms, and the pose's."""
    pose_topic: str | None = None
    settled: frozenset[str] = frozenset()
    """Frames of which only the pose's topic, or an extrinsic, says where they are."""

    def takes(self, topic: str, transform: Transform) -> bool:
        """True unless it is settled otherwise where that frame is."""
        return topic == self.pose_topic or transform.child not in self.settled


def find_places(log: Log, choice: Choice, found: Probe, tree: Tree, options: Options) -> Places:
    """Raises InputError where nothing leads from a world to the camera. Adds to the tree what belongs to a pose."""
    here = choice.depth_picture.frame_id
    camera = (options.camera or here).lstrip("/")
    inner = Pose.identity()
    if options.camera and choice.color_picture and camera == choice.color_picture.frame_id != here:
        inner = _color_from_depth(log, choice, tree, options)
    pose_topic = _pose_topic(log, tree, camera, options)
    settled = frozenset[str]()
    if pose_topic is not None:
        settled = _put_on(log, pose_topic, found, tree, camera, options)
    way = tree.way_up(camera)
    world = (options.world or next((name for name in WORLDS if name in way), way[-1])).lstrip("/")
    if len(way) == 1 and not options.world:
        names = ", ".join(sorted({*tree.parent, *tree.parent.values()})[:20]) or "none"
        raise InputError(
            f"{log.path} has no transform of the camera's frame {camera!r} within its first seconds (frames: {names}); "
            "name another with --camera FRAME, or give --poses TRAJECTORY"
        )
    topics = {topic for topic, kind in log.topics.items() if kind == "transforms"}
    return Places(
        world, camera, inner, frozenset(topics | ({pose_topic} if pose_topic else set())), pose_topic, settled
    )


def _color_from_depth(log: Log, choice: Choice, tree: Tree, options: Options) -> Pose:
    """Where the depth camera sits beside the colour camera whose pose is taken."""
    assert choice.color_picture is not None
    if options.color_from_depth is not None:
        return read_transform(options.color_from_depth)
    here, there = choice.depth_picture.frame_id, choice.color_picture.frame_id
    found = tree.lookup(there, here, choice.depth_picture.stamp_ns)
    if isinstance(found, Pose):
        return found
    if choice.registered:
        return Pose.identity()
    raise InputError(f"{log.path}: --camera {there} is colour's, and there is {found}; give --color-from-depth FILE")


def _pose_topic(log: Log, tree: Tree, camera: str, options: Options) -> str | None:
    """The topic named, or the only one where transforms alone do not move the camera."""
    if "pose" in options.topics:
        return options.topics["pose"]
    topics = sorted(topic for topic, kind in log.topics.items() if kind == "pose")
    if not topics or tree.between(tree.way_up(camera)[-1], camera):
        return None
    if len(topics) > 1:
        raise InputError(
            f"{log.path} has several topics of poses ({', '.join(topics)}) and no transforms that move the camera; "
            "choose with --topic pose=NAME"
        )
    return topics[0]


def _put_on(log: Log, topic: str, found: Probe, tree: Tree, camera: str, options: Options) -> frozenset[str]:
    """Puts the camera on what the topic tells the way of; the frames that are settled by that."""
    first = next((transform for name, transform in found.transforms if name == topic), None)
    if first is None:
        raise InputError(f"{log.path}: {topic} has no pose within its first seconds")
    settled = {first.child}
    if options.extrinsic is not None or first.child not in tree.way_up(camera):
        if first.child != topic.lstrip("/") and options.extrinsic is None:
            raise InputError(
                f"{log.path}: {topic} is the pose of {first.child!r}, and no transform says where the camera "
                f"{camera!r} sits on it; give --extrinsic FILE (a 4x4 matrix, camera to {first.child})"
            )
        mount = Pose.identity() if options.extrinsic is None else read_transform(options.extrinsic)
        tree.add(Transform(0, first.child, camera, mount, static=True))
        settled.add(camera)
    tree.static.pop(first.child, None)
    tree.parent.pop(first.child, None)
    tree.add(first)
    return frozenset(settled)
