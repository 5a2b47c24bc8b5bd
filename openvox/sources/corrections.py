"""What a person knows better than the source: the unit of its depth, and what its poses mean."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from openvox.core.errors import InputError
from openvox.core.types import DepthImage, Frame, Pose
from openvox.sources.source import Dropped, Matrix, Options, Source, read_transform
from openvox.sources.transforms import Track, compose, inverse

OURS = "RDF"
"""Right, down, forward: where x, y and z of openvox's cameras point."""
_DIRECTIONS = {
    "R": (1.0, 0.0, 0.0),
    "L": (-1.0, 0.0, 0.0),
    "D": (0.0, 1.0, 0.0),
    "U": (0.0, -1.0, 0.0),
    "F": (0.0, 0.0, 1.0),
    "B": (0.0, 0.0, -1.0),
}
AXES = tuple(
    "".join(letters)
    for order in itertools.permutations(("RL", "DU", "FB"))
    for letters in itertools.product(*order)
)  # fmt: skip
"""Every way of pointing; half of them are left-handed, as in Unity (RUF)."""


def axes_from_ours(axes: str) -> Matrix:
    """(3, 3): coordinates in a camera of openvox to those in one whose axes point so."""
    if axes not in AXES:
        raise InputError(
            f"camera axes are {axes!r}; expected where x, y and z point, as RDF (right, down, forward), RUB (OpenGL) "
            "or FLU (a robot's body)"
        )
    return np.array([_DIRECTIONS[letter] for letter in axes])


def ours(matrix: Matrix, axes: str) -> Matrix:
    """(..., 4, 4): poses of a camera with such axes as poses of ours; a left-handed world is mirrored in y."""
    turn, mirror = np.eye(4), np.eye(4)
    turn[:3, :3] = axes_from_ours(axes)
    mirror[1, 1] = np.linalg.det(turn)
    return mirror @ matrix @ turn


def meant(pose: Pose, options: Options) -> Pose:
    """The camera-to-world pose of a camera of ours, of what the source calls a pose."""
    if options.poses_inverted:
        pose = inverse(pose)
    return pose if options.pose_axes == OURS else Pose.from_matrix(ours(pose.matrix(), options.pose_axes))


def corrected(source: Source, options: Options) -> Source:
    """The source with its depth, stamps and poses as the options say that they are meant. Raises InputError."""
    axes_from_ours(options.pose_axes)
    said = []
    if options.depth_scale != 1:
        said.append(f"depth was multiplied by {options.depth_scale:g}")
    if options.poses_inverted:
        said.append("poses were inverted: the source has world-to-camera")
    if options.pose_axes != OURS:
        said.append(f"poses are of a camera with the axes {options.pose_axes}; they were turned to {OURS}")
    if options.pose_shift:
        said.append(f"pictures have the poses of {options.pose_shift:g} s later")
    mount = Pose.identity()
    if options.extrinsic is not None and options.poses is None and "pose" not in options.topics:
        mount = read_transform(options.extrinsic)
        said.append(f"where the camera sits on what the poses are of was taken from {options.extrinsic.name}")
    if not said and not options.invent_stamps:
        return source
    frames: Iterator[Frame | Dropped] = (
        frame if isinstance(frame, Dropped) else _corrected(frame, options, mount) for frame in source.frames
    )
    if options.pose_shift:
        frames = _shifted(frames, round(options.pose_shift * 1e9))
    return replace(source, notes=(*source.notes, *said), frames=frames)


def _corrected(frame: Frame, options: Options, mount: Pose) -> Frame:
    pose, depth, stamp = frame.world_from_depth, frame.depth, frame.stamp_ns
    if options.poses is None:
        pose = meant(pose, options)
    if mount != Pose.identity():
        pose = compose(pose, mount)
    if options.depth_scale != 1:
        depth = _scaled(depth, options.depth_scale)
    if options.invent_stamps:
        stamp = options.stamp(frame.index)
    return replace(frame, world_from_depth=pose, depth=depth, stamp_ns=stamp)


def _scaled(depth: DepthImage, scale: float) -> DepthImage:
    """Rounded half to even; what does not fit into 16 bits is no measurement."""
    millimetres = np.rint(depth * scale)
    return np.where(millimetres < 1 << 16, millimetres, 0).astype(np.uint16)


def _shifted(frames: Iterator[Frame | Dropped], shift_ns: int) -> Iterator[Frame | Dropped]:
    """Each frame with the pose that the frames around have at a later (or earlier) stamp."""
    track, waiting = Track(window_ns=10_000_000_000 + 2 * abs(shift_ns)), deque[Frame | Dropped]()

    def placed(frame: Frame | Dropped) -> Frame | Dropped:
        if isinstance(frame, Dropped):
            return frame
        pose = track.at(frame.stamp_ns + shift_ns, 1_000_000_000)
        if isinstance(pose, str):
            return Dropped(frame.index, f"with --pose-shift the way of the poses {pose}")
        return replace(frame, world_from_depth=pose)

    for frame in frames:
        if not isinstance(frame, Dropped):
            track.add(frame.stamp_ns, frame.world_from_depth)
        waiting.append(frame)
        while waiting and (isinstance(waiting[0], Dropped) or track.reaches(waiting[0].stamp_ns + shift_ns)):
            yield placed(waiting.popleft())
    yield from (placed(frame) for frame in waiting)
