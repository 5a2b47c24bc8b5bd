"""Frames of files that lie beside each other: a colour picture, a depth picture and a pose for each."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from openvox.core.errors import InputError
from openvox.core.types import DepthImage, Frame, Intrinsics, Pose, Rig
from openvox.sources.source import Dropped, depth_table, read_grey, read_picture, read_text


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame's files. `pose`: world_from_depth, or why there is none."""

    number: int
    stamp_ns: int
    color: Path
    depth: Path
    pose: Pose | str


def frames(
    shots: Iterable[Shot],
    rig: Rig,
    units_per_metre: int = 1000,
    cleaned: Callable[[DepthImage], DepthImage] = lambda depth: depth,
) -> Iterator[Frame | Dropped]:
    """The frames of the shots. cleaned: takes what is no measurement out of the raw depth."""
    table = depth_table(Decimal(units_per_metre))
    sizes = [(camera.width, camera.height) for camera in (rig.color, rig.depth)]
    last = -1
    for shot in shots:
        if isinstance(shot.pose, str):
            yield Dropped(shot.number, shot.pose)
        elif shot.stamp_ns <= last:
            yield Dropped(shot.number, "a stamp that is not after that of the frame before")
        else:
            color, color_format, _ = read_picture(shot.color, sizes[0])
            depth = table[cleaned(read_grey(shot.depth, sizes[1]))]
            last = shot.stamp_ns
            yield Frame(shot.number, shot.stamp_ns, shot.pose, rig, depth, color, color_format)


def size_of(path: Path) -> tuple[int, int]:
    """Width and height of a picture."""
    return read_picture(path)[2]


def nearest(stamps: Sequence[int], stamp: int, within_ns: float) -> int | None:
    """Index of the stamp nearest to that, the earlier one of two; None if none is near enough. stamps: ascending."""
    from bisect import bisect_left

    at = bisect_left(stamps, stamp)
    best = min((i for i in (at - 1, at) if 0 <= i < len(stamps)), key=lambda i: abs(stamps[i] - stamp), default=None)
    return best if best is not None and abs(stamps[best] - stamp) <= within_ns else None


def open3d_camera(path: Path) -> Intrinsics:
    """A camera of Open3D's JSON: width, height, and the matrix column by column."""
    try:
        content = json.loads(read_text(path))
        m = [float(value) for value in content["intrinsic_matrix"]]
        if len(m) != 9:
            raise ValueError(f"intrinsic_matrix has {len(m)} numbers, not 9")
        return Intrinsics(int(content["width"]), int(content["height"]), m[0], m[4], m[6], m[7])
    except (ValueError, TypeError, KeyError, RecursionError, InputError) as error:
        raise InputError(f"{path}: {error!s:.200}; expected width, height, intrinsic_matrix (9, by column)") from error
