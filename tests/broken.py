"""A good recording broken in every way that doctor knows, small and large, by code of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from openvox.core.types import Frame, Intrinsics, Pose, Rig

Frames = list[Frame]
Break = Callable[[Frames], Frames]
Array = NDArray[Any]


def _depth(frame: Frame, values: Array) -> Frame:
    return replace(frame, depth=np.where((values >= 0) & (values < 65536), values, 0).astype(np.uint16))


def depth_times(factor: float) -> Break:
    return lambda frames: [_depth(f, np.rint(f.depth * factor)) for f in frames]


def _posed(change: Callable[[Array], Array]) -> Break:
    return lambda frames: [
        replace(f, world_from_depth=Pose.from_matrix(change(f.world_from_depth.matrix()))) for f in frames
    ]


def turned(axis: str, degrees: float) -> Break:
    """The poses are of something that is turned against the camera."""
    mount = np.eye(4)
    mount[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return _posed(lambda pose: pose @ mount)


def axes(*rows: tuple[int, int, int]) -> Break:
    """The poses are of a camera whose x, y, z are these directions of ours; the world is mirrored if need be."""
    body_from_ours, mirror = np.eye(4), np.eye(4)
    body_from_ours[:3, :3] = rows
    mirror[0, 0] = round(np.linalg.det(body_from_ours))
    return _posed(lambda pose: mirror @ pose @ np.linalg.inv(body_from_ours))


def transposed(pose: Array) -> Array:
    out = pose.copy()
    out[:3, :3] = pose[:3, :3].T
    return out


def swapped_quaternion(frames: Frames) -> Frames:
    """w x y z read as x y z w."""
    out = []
    for f in frames:
        x, y, z, w = f.world_from_depth.quaternion
        out.append(replace(f, world_from_depth=replace(f.world_from_depth, quaternion=(w, x, y, z))))
    return out


def late(seconds: float) -> Break:
    """Each picture has the pose of so much earlier."""

    def change(frames: Frames) -> Frames:
        stamps = np.array([f.stamp_ns for f in frames]) / 1e9
        poses = np.array([f.world_from_depth.matrix() for f in frames])
        wanted = np.clip(stamps - seconds, stamps[0], stamps[-1])
        turns = Slerp(stamps, Rotation.from_matrix(poses[:, :3, :3]))(wanted).as_matrix()
        out = []
        for i, f in enumerate(frames):
            pose = np.eye(4)
            pose[:3, :3] = turns[i]
            pose[:3, 3] = [np.interp(wanted[i], stamps, poses[:, a, 3]) for a in range(3)]
            out.append(replace(f, world_from_depth=Pose.from_matrix(pose)))
        return out

    return change


def color_turned(axis: str, degrees: float) -> Break:
    """The transform between the cameras is wrong."""
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()

    def change(f: Frame) -> Frame:
        matrix = f.rig.depth_from_color.matrix() @ turn
        return replace(f, rig=replace(f.rig, depth_from_color=Pose.from_matrix(matrix)))

    return lambda frames: [change(f) for f in frames]


def color_shifted(share: float) -> Break:
    """The colour picture is moved to the right by that share of its width."""

    def change(f: Frame) -> Frame:
        image = cv2.imdecode(np.frombuffer(f.color, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        by = np.array([[1, 0, share * image.shape[1]], [0, 1, 0]], np.float64)
        moved = cv2.warpAffine(image, by, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
        return replace(f, color=cv2.imencode(".png", moved)[1].tobytes(), color_format="png")

    return lambda frames: [change(f) for f in frames]


def as_registered(frames: Frames) -> Frames:
    """Two cameras, of which one is said to be the other."""
    return [replace(f, rig=Rig(f.rig.depth, replace(f.rig.depth, width=f.rig.color.width))) for f in frames]


def color_focal(factor: float) -> Break:
    def change(f: Frame) -> Frame:
        c = f.rig.color
        return replace(f, rig=replace(f.rig, color=replace(c, fx=c.fx * factor, fy=c.fy * factor)))

    return lambda frames: [change(f) for f in frames]


def both_cameras(change: Callable[[Intrinsics], Intrinsics]) -> Break:
    return lambda frames: [
        replace(f, rig=replace(f.rig, depth=change(f.rig.depth), color=change(f.rig.color))) for f in frames
    ]


def focal(factor: float) -> Break:
    return both_cameras(lambda c: replace(c, fx=c.fx * factor, fy=c.fy * factor))


def other_size(factor: float) -> Break:
    """Intrinsics of a larger or smaller picture."""
    return both_cameras(lambda c: replace(c, fx=c.fx * factor, fy=c.fy * factor, cx=c.cx * factor, cy=c.cy * factor))


def gap(seconds: float) -> Break:
    """That much is missing in the middle; the frames are numbered through."""

    def change(frames: Frames) -> Frames:
        middle = frames[len(frames) // 2].stamp_ns
        kept = [f for f in frames if not middle <= f.stamp_ns < middle + seconds * 1e9]
        return [replace(f, index=i) for i, f in enumerate(kept)]

    return change


def clock(seconds: float) -> Break:
    """The clock is set forward in the middle."""
    return lambda frames: [
        replace(f, stamp_ns=f.stamp_ns + round(seconds * 1e9) * (i >= len(frames) // 2)) for i, f in enumerate(frames)
    ]


def black(share: float) -> Break:
    def change(i: int, f: Frame) -> Frame:
        if math.floor((i + 1) * share) == math.floor(i * share):
            return f
        image = np.zeros((f.rig.color.height, f.rig.color.width, 3), np.uint8)
        return replace(f, color=cv2.imencode(".png", image)[1].tobytes(), color_format="png")

    return lambda frames: [change(i, f) for i, f in enumerate(frames)]


def holes(share: float) -> Break:
    """That share of the depth pixels is lost, in blobs."""

    def change(i: int, f: Frame) -> Frame:
        noise = np.random.default_rng(i).random((24, 32)).astype(np.float32)
        size = (f.depth.shape[1], f.depth.shape[0])
        kept = cv2.resize(noise, size, interpolation=cv2.INTER_NEAREST) >= share
        return replace(f, depth=f.depth * kept)

    return lambda frames: [change(i, f) for i, f in enumerate(frames)]


BREAKS: dict[str, tuple[str, Break]] = {
    "depth x 5": ("depth_unit", depth_times(5.0)),
    "depth / 5": ("depth_unit", depth_times(0.2)),
    "depth x 1000": ("depth_unit", lambda frames: [_depth(f, np.minimum(f.depth * 1000.0, 65535)) for f in frames]),
    "depth / 1000": ("depth_unit", depth_times(0.001)),
    "depth x 2": ("depth_unit", depth_times(2.0)),
    "depth x 1.25": ("depth_unit", depth_times(1.25)),
    "poses inverted": ("pose_inverted", _posed(np.linalg.inv)),
    "axes of OpenGL": ("pose_axes", axes((1, 0, 0), (0, -1, 0), (0, 0, -1))),
    "axes of a body (FLU)": ("pose_axes", axes((0, 0, 1), (-1, 0, 0), (0, -1, 0))),
    "axes of Unity, left-handed": ("pose_axes", axes((1, 0, 0), (0, -1, 0), (0, 0, 1))),
    "rotation transposed": ("pose_axes", _posed(transposed)),
    "quaternion w first": ("pose_axes", swapped_quaternion),
    "poses turned 10 deg, x": ("pose_axes", turned("x", 10)),
    "poses turned 10 deg, y": ("pose_axes", turned("y", -10)),
    "poses turned 10 deg, z": ("pose_axes", turned("z", 10)),
    "poses turned 5 deg, y": ("pose_axes", turned("y", 5)),
    "poses turned 45 deg, x": ("pose_axes", turned("x", 45)),
    "poses 50 ms late": ("pose_time", late(0.05)),
    "poses 50 ms early": ("pose_time", late(-0.05)),
    "poses 200 ms late": ("pose_time", late(0.2)),
    "poses 1 s late": ("pose_time", late(1.0)),
    "colour turned 10 deg, y": ("registration", color_turned("y", 10)),
    "colour turned 10 deg, z": ("registration", color_turned("z", 10)),
    "colour turned 3 deg, x": ("registration", color_turned("x", 3)),
    "colour focal x 1.1": ("registration", color_focal(1.1)),
    "colour shifted by 3 %": ("registration", color_shifted(0.03)),
    "colour shifted by 12 %": ("registration", color_shifted(-0.12)),
    "focal x 1.2": ("intrinsics", focal(1.2)),
    "focal x 0.7": ("intrinsics", focal(0.7)),
    "intrinsics of twice the size": ("intrinsics", other_size(2.0)),
    "intrinsics of half the size": ("intrinsics", other_size(0.5)),
    "gap of 0.8 s": ("stamps", gap(0.8)),
    "gap of 3 s": ("stamps", gap(3.0)),
    "clock forward 2 s": ("clock", clock(2.0)),
    "clock forward 1 h": ("clock", clock(3600.0)),
    "pictures black": ("black", black(1.0)),
    "a third black": ("black", black(1 / 3)),
    "80 % of depth missing": ("depth_missing", holes(0.8)),
    "all depth missing": ("depth_missing", depth_times(0.0)),
}
"""Name to the code that doctor must give first, and what breaks it."""


def broken(frames: Sequence[Frame], name: str) -> Frames:
    return BREAKS[name][1](list(frames))
