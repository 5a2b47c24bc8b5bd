"""7-Scenes: frame-000000.color.png, .depth.png (millimetres, 65535 = nothing) and .pose.txt in a folder seq-NN.

Intrinsics are not in the folder. Depth and colour are two cameras that are not registered; the data set's own advice is
585 and (320, 240) for depth, 525 for colour. --camera FILE replaces the colour camera.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from openvox.core.errors import InputError
from openvox.core.types import DepthImage, Intrinsics, Pose, Rig
from openvox.sources import shots
from openvox.sources.source import (
    NO_POSE,
    TWO_CAMERAS,
    Options,
    Source,
    camera_file,
    numbered,
    parse_matrix,
    pose_of,
    read_text,
)

WANTED = ("frame-000000.color.png", "frame-000000.depth.png", "frame-000000.pose.txt")
NOTHING = 65535
_DEPTH, _COLOR = (585.0, 585.0, 320.0, 240.0), (525.0, 525.0, 320.0, 240.0)


def missing(folder: Path, options: Options) -> list[str]:
    """What a folder lacks to be such a sequence."""
    wanted = WANTED[:2] if options.poses else WANTED
    suffixes = (name.removeprefix("frame-000000") for name in wanted)
    return [name for name, end in zip(wanted, suffixes, strict=True) if not any(folder.glob(f"frame-*{end}"))]


def read(folder: Path, options: Options) -> Source:
    """Opens a sequence. Raises InputError, also while iterating."""
    color, depth, pose = (
        numbered(folder, (suffix,), "frame-", middle)
        for suffix, middle in ((".png", ".color"), (".png", ".depth"), (".txt", ".pose"))
    )
    chosen = options.chosen(folder, sorted({*color, *depth}))
    for number in chosen:
        if number not in color or number not in depth or not (number in pose or options.poses):
            raise InputError(f"{folder}, frame {number}: expected a color.png, a depth.png and a pose.txt")
    sizes = shots.size_of(color[chosen[0]]), shots.size_of(depth[chosen[0]])
    for size in sizes:
        if size != (640, 480):
            raise InputError(f"{folder}: a picture of {size[0]}x{size[1]} pixels; 7-Scenes has 640x480")
    given = None if options.camera is None else camera_file(Path(options.camera), sizes[0])
    rig = Rig(Intrinsics(*sizes[1], *_DEPTH), given or Intrinsics(*sizes[0], *_COLOR))
    notes = (
        f"stamps were invented at {options.fps:g} frames a second: the format has none",
        "the depth camera is the data set's (585, 320, 240); "
        + ("the colour camera is that of --camera" if given else "the colour camera is taken as 525, 320, 240"),
        TWO_CAMERAS,
    )
    found = shots.frames(_shots(chosen, color, depth, pose, options), rig, cleaned=_cleaned)
    return Source("7scenes", "mm", {}, notes, len(chosen), found)


def _cleaned(depth: DepthImage) -> DepthImage:
    return np.where(depth == NOTHING, 0, depth).astype(np.uint16)


def _shots(
    chosen: list[int], color: dict[int, Path], depth: dict[int, Path], pose: dict[int, Path], options: Options
) -> Iterator[shots.Shot]:
    for number in chosen:
        found: Pose | None = Pose.identity()
        if not options.poses:
            path = pose[number]
            found = pose_of(parse_matrix(read_text(path), str(path)), options.origin, str(path))
        yield shots.Shot(number, options.stamp(number), color[number], depth[number], found or NO_POSE)
