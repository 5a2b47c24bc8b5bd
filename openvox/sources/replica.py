"""Replica as NICE-SLAM renders it: results/frame*.jpg, results/depth*.png, traj.txt, and cam_params.json (there or one
level up). Depth is 16-bit PNG in units of 1 / scale metres, a line of traj.txt a 4x4 camera-to-world matrix."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics, Rig
from openvox.sources.source import (
    NO_POSE,
    Dropped,
    Options,
    Source,
    depth_table,
    numbered,
    parse_matrix,
    pose_of,
    read_grey,
    read_picture,
    read_text,
)

WANTED = ("results/", "traj.txt", "cam_params.json")
DEPTH_SCALE = "6553.5"
"""Units of a metre where cam_params.json gives none."""


def missing(folder: Path, options: Options) -> list[str]:
    """What a folder lacks to be such a scene."""
    found = ((folder / "results").is_dir(), (folder / "traj.txt").is_file(), _parameters_file(folder) is not None)
    return [name for name, there in zip(WANTED, found, strict=True) if not there]


def read(folder: Path, options: Options) -> Source:
    """Opens a scene. Raises InputError for what is missing or is not what it should be, also while iterating."""
    color = numbered(folder / "results", (".jpg", ".jpeg", ".png"), "frame")
    depth = numbered(folder / "results", (".png",), "depth")
    poses = read_text(folder / "traj.txt").splitlines()
    numbers = sorted({*color, *depth})
    if not numbers:
        raise InputError(f"{folder / 'results'} has no frame*.jpg and depth*.png")
    chosen = options.chosen(folder, numbers)
    for number in chosen:
        if number not in color or number not in depth or number >= len(poses):
            raise InputError(
                f"{folder}, frame {number}: expected frame{number:06d}.jpg and depth{number:06d}.png in results/ and "
                f"line {number + 1} of traj.txt, which has {len(poses)}"
            )
    parameters = _parameters_file(folder)
    assert parameters is not None, "checked by missing()"
    camera, scale = _camera(parameters)
    return Source(
        kind="replica",
        depth_unit=f"1/{scale} m",
        categories={},
        notes=(
            f"stamps were invented at {options.fps:g} frames a second: the format has none",
            f"depth in units of 1/{scale} m was rounded to millimetres, half to even",
        ),
        total=len(chosen),
        frames=_frames(folder / "traj.txt", color, depth, poses, chosen, Rig(camera, camera), scale, options),
    )


def _parameters_file(folder: Path) -> Path | None:
    """cam_params.json of the scene, or of the folder of scenes."""
    candidates = (folder / "cam_params.json", folder.resolve().parent / "cam_params.json")
    return next((path for path in candidates if path.is_file()), None)


def _camera(path: Path) -> tuple[Intrinsics, Decimal]:
    """The camera, and depth units a metre as written."""
    try:
        camera: Mapping[str, Any] = json.loads(read_text(path), parse_float=Decimal, parse_int=Decimal)["camera"]
        scale = Decimal(camera.get("scale", DEPTH_SCALE))
        intrinsics = Intrinsics(
            int(camera["w"]), int(camera["h"]), *(float(camera[name]) for name in ("fx", "fy", "cx", "cy"))
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError, RecursionError) as error:
        raise InputError(f"{path}: expected camera: {{w, h, fx, fy, cx, cy, scale}}, found {error!r}") from error
    if not 1000 <= scale <= 10**6:
        raise InputError(f"{path}: depth scale is {scale}; expected 1000 to 1000000 units a metre")
    return intrinsics, scale


def _frames(
    trajectory: Path,
    color: Mapping[int, Path],
    depth: Mapping[int, Path],
    poses: list[str],
    chosen: list[int],
    rig: Rig,
    scale: Decimal,
    options: Options,
) -> Iterator[Frame | Dropped]:
    table, size = depth_table(scale), (rig.depth.width, rig.depth.height)
    for number in chosen:
        where = f"{trajectory}, line {number + 1}"
        pose = pose_of(parse_matrix(poses[number], where), options.origin, where)
        if pose is None:
            yield Dropped(number, NO_POSE)
            continue
        picture, color_format, _ = read_picture(color[number], size)
        yield Frame(
            index=number,
            stamp_ns=options.stamp(number),
            world_from_depth=pose,
            rig=rig,
            depth=table[read_grey(depth[number], size)],
            color=picture,
            color_format=color_format,
        )
