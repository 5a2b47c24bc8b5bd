"""A robot's log to frames: colour and depth paired by stamp, each with the camera's pose at that stamp.

One pass in the order of logging. A depth picture waits until the transforms have caught up with its stamp, so that
what is held in memory does not grow with the log.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from openvox.core.errors import InputError
from openvox.core.types import Frame, Pose, Rig
from openvox.formats.recording import MAX_STAMP_NS
from openvox.formats.robot_log import Log, Picture
from openvox.sources.log_pictures import Camera, color_file, depth_image, size_of
from openvox.sources.log_places import Places, find_places
from openvox.sources.log_topics import Choice, choose, probe
from openvox.sources.source import TWO_CAMERAS, Dropped, Options, Source
from openvox.sources.transforms import Track, Tree, placed

HOLD_NS = 1_000_000_000
"""Log time that a depth picture waits for its colour and its transforms."""
MAX_HELD = 120
"""Pictures that are held at most, whatever the log's clock says."""
JUMP_NS = 1_000_000_000
UNREADABLE = "a picture that cannot be decoded"


def read(log: Log, options: Options) -> Source:
    """Opens a log. Raises InputError for one that has no RGB-D camera, calibration or pose, or too many."""
    found = probe(log)
    choice = choose(log, found, options.topics)
    tree = Tree(round(options.max_gap * 1e9))
    for topic, transform in found.transforms:
        if log.topics[topic] == "transforms":
            tree.add(transform)
    rig, color_camera, depth_camera = _rig(log, choice, tree, options)
    places = None if options.poses else find_places(log, choice, found, tree, options)
    notes = tuple(_notes(choice, rig, color_camera, depth_camera, places))
    tree.tracks.clear()  # the way through the log begins anew
    late: list[str] = []
    frames = _Frames(log, choice, options, tree, rig, color_camera, depth_camera, places, late)
    return Source(log.kind, _unit(choice.depth_picture), {}, notes, 0, frames.run(), late)


def _rig(log: Log, choice: Choice, tree: Tree, options: Options) -> tuple[Rig, Camera | None, Camera]:
    """Both cameras; between them what the transforms that never move say."""
    depth = _camera(log, choice.depth, choice.depth_picture, choice)
    if choice.color_picture is None:
        return Rig(depth.intrinsics, depth.intrinsics), None, depth
    color = _camera(log, choice.color, choice.color_picture, choice)
    for picture, camera in ((choice.depth_picture, depth), (choice.color_picture, color)):
        try:  # a log whose first pictures cannot be read is refused at once
            if picture is choice.depth_picture:
                depth_image(picture, camera)
            else:
                color_file(picture, camera)
        except InputError as error:
            topic = choice.depth if picture is choice.depth_picture else choice.color
            raise InputError(f"{log.path}, {topic}: {error}") from error
    here, there = choice.depth_picture.frame_id, choice.color_picture.frame_id
    rig = Rig(depth.intrinsics, color.intrinsics)
    if here == there or options.color_from_depth is not None or (rig.registered and choice.registered):
        return rig, color, depth
    stamp = choice.depth_picture.stamp_ns
    between = tree.lookup(here, there, stamp)
    if isinstance(between, str):
        raise InputError(
            f"{log.path}: depth is seen from {here or 'no frame'} and colour from {there or 'no frame'}, and there is "
            f"{between}; give --color-from-depth FILE (a 4x4 matrix, the identity if depth is registered to colour)"
        )
    return replace(rig, depth_from_color=between), color, depth


def _camera(log: Log, topic: str, picture: Picture, choice: Choice) -> Camera:
    info = choice.depth_info if topic == choice.depth else choice.color_info
    assert info is not None
    try:
        return Camera.of(info, size_of(picture), "rect" in topic.rpartition("/image")[2] or "/rect" in topic)
    except InputError as error:
        raise InputError(f"{log.path}, {topic}: {error}") from error


def _unit(picture: Picture) -> str:
    return "m" if picture.encoding == "32FC1" else "mm"


def _notes(choice: Choice, rig: Rig, color: Camera | None, depth: Camera, places: Places | None) -> Iterator[str]:
    yield f"colour from {choice.color or 'no topic'}, depth from {choice.depth}"
    if places is not None:
        yield f"poses are those of {places.camera} in {places.world}"
    for name, camera in (("colour", color), ("depth", depth)):
        if camera is not None and camera.distorted:
            yield f"{name} was rectified: its lens distorts ({camera.model or 'plumb_bob'})"
    if choice.color_picture is not None and (
        choice.color_picture.encoding != "compressed" or (color and color.distorted)
    ):
        yield "colour was stored as PNG: what the log holds is no JPEG or PNG file, or had to be rectified"
    if choice.color and not rig.registered:
        yield TWO_CAMERAS
    if _unit(choice.depth_picture) == "m":
        yield "depth in metres was rounded to millimetres, half to even"


@dataclass
class _Waiting:
    number: int
    logged_ns: int
    picture: Picture


@dataclass
class _Frames:
    """The way through the log."""

    log: Log
    choice: Choice
    options: Options
    tree: Tree
    rig: Rig
    color_camera: Camera | None
    depth_camera: Camera
    places: Places | None
    notes: list[str]
    depths: deque[_Waiting] = field(default_factory=deque)
    colors: deque[Picture] = field(default_factory=deque)
    last: tuple[int, int] | None = None
    """Stamp and time of logging of the last frame."""
    jumps: int = 0

    def run(self) -> Iterator[Frame | Dropped]:
        """All frames that are asked for, then the late notes."""
        topics = {*self.choice.topics, *(self.places.topics if self.places else ())}
        number, ended = 0, False
        for now, topic, item in self.log.read(topics):
            if isinstance(item, tuple):
                for transform in item:
                    if self.places and self.places.takes(topic, transform):
                        self.tree.add(transform)
            elif isinstance(item, Picture) and topic == self.choice.depth:
                if self.options.takes(number):
                    self.depths.append(_Waiting(number, now, item))
                number += 1
                ended = self.options.end is not None and number >= self.options.end
            elif isinstance(item, Picture):
                self.colors.append(item)
                if len(self.colors) > MAX_HELD:
                    self.colors.popleft()
            while self.depths and self._ripe(self.depths[0], now):
                yield self._frame(self.depths.popleft())
            if ended and not self.depths:
                break
        while self.depths:
            yield self._frame(self.depths.popleft())
        self.notes.extend(self._late_notes())

    def _ripe(self, waiting: _Waiting, now: int) -> bool:
        """True if more of the log would not help any longer, or must not be waited for."""
        stamp = waiting.picture.stamp_ns
        colored = not self.choice.color or any(color.stamp_ns >= stamp for color in self.colors)
        known = self.places is None or self.tree.ready(self.places.world, self.places.camera, stamp)
        return (colored and known) or now - waiting.logged_ns > HOLD_NS or len(self.depths) > MAX_HELD

    def _frame(self, waiting: _Waiting) -> Frame | Dropped:
        picture, number = waiting.picture, waiting.number
        reason = self._misfit(picture.stamp_ns, waiting.logged_ns)
        color = None if reason or not self.choice.color else self._color_of(picture.stamp_ns)
        if not reason and color is None and self.choice.color:
            reason = f"no colour within {self.options.tolerance * 1000:g} ms"
        pose = reason or self._pose(picture.stamp_ns)
        if isinstance(pose, str):
            return Dropped(number, pose)
        try:
            depth = depth_image(picture, self.depth_camera)
            file = (b"", "") if color is None or self.color_camera is None else color_file(color, self.color_camera)
            frame = Frame(number, picture.stamp_ns, pose, self.rig, depth, file[0], file[1])  # type: ignore[arg-type]
        except InputError:
            return Dropped(number, UNREADABLE)
        self.last = (picture.stamp_ns, waiting.logged_ns)
        return frame

    def _misfit(self, stamp: int, logged: int) -> str:
        """Why a stamp cannot follow the last one; nothing if it can."""
        if not 0 <= stamp < MAX_STAMP_NS:
            return "a stamp before 1970 or after 2038"
        if self.last is None:
            return ""
        if stamp <= self.last[0]:
            if stamp == self.last[0]:
                return "a stamp that was there already"
            return "a stamp before that of the frame before (the clock went back, or messages are out of order)"
        self.jumps += (stamp - self.last[0]) - (logged - self.last[1]) > JUMP_NS
        return ""

    def _color_of(self, stamp: int) -> Picture | None:
        """The nearest colour picture, if it is near enough; it and all before it are used up."""
        best = min(self.colors, key=lambda color: (abs(color.stamp_ns - stamp), color.stamp_ns), default=None)
        if best is None or abs(best.stamp_ns - stamp) > self.options.tolerance * 1e9:
            return None
        self.colors = deque(color for color in self.colors if color.stamp_ns > best.stamp_ns)
        return best

    def _pose(self, stamp: int) -> Pose | str:
        if self.places is None:
            return Pose.identity()
        pose = self.tree.lookup(self.places.world, self.places.camera, stamp)
        return pose if isinstance(pose, str) else placed(pose, self.places.camera_from_depth, self.options.origin)

    def _late_notes(self) -> Iterator[str]:
        tracks: dict[str, Track] = self.tree.tracks
        for what, count in (
            ("transforms came with a stamp that was there already", sum(t.repeated for t in tracks.values())),
            ("transforms came out of order and were put where they belong", sum(t.disordered for t in tracks.values())),
            ("times a frame changed its parent in the tree of transforms", self.tree.changed),
            ("times the clock jumped forward by more than a second", self.jumps),
        ):
            if count:
                yield f"{count} {what}"
