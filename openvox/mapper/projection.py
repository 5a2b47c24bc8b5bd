"""From depth pixels to voxels, in integers: pose and intrinsics are quantised once a frame, the rest is int64."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import Intrinsics, Pose, Rig
from openvox.core.voxels import RANGE

MAX_MILLIMETRES = 65535


@dataclass(frozen=True, eq=False)
class Rays:
    """A camera's pixel rays: column and row slopes in Q18, (width,) and (height,) int64."""

    x: NDArray[np.int64]
    y: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class VoxelTransform:
    """camera -> voxels: coordinate a = (z (A[a,0] x + A[a,1] y + (A[a,2] << 18)) + c[a]) >> 46) + b[a].

    z in millimetres, x and y rays in Q18; rotation A in voxels a millimetre, Q28; translation split into whole
    voxels b and a fraction c in Q46."""

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    c: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ColorLookup:
    """depth pixel -> colour pixel: rotation in Q26, translation in millimetres Q44, intrinsics in Q16."""

    rotation: NDArray[np.int64]
    translation: NDArray[np.int64]
    fx: int
    fy: int
    cx: int
    cy: int


def pixel_rays(camera: Intrinsics) -> Rays:
    """The slopes (u - cx) / fx and (v - cy) / fy of every column and row, in Q18, half to even."""
    x = [round((u - camera.cx) / camera.fx * (1 << 18)) for u in range(camera.width)]
    y = [round((v - camera.cy) / camera.fy * (1 << 18)) for v in range(camera.height)]
    return Rays(np.array(x, np.int64), np.array(y, np.int64))


def voxel_transform(world_from_camera: Pose, voxel_size: float, rays: Rays, max_depth_mm: int) -> VoxelTransform:
    """The pose in voxels. Raises InputError if it could leave the voxel range or overflow 63 bits."""
    voxel_mm = voxel_size * 1000.0
    a = [[round(value / voxel_mm * (1 << 28)) for value in row] for row in world_from_camera.rotation()]
    b, c = [], []
    for metres in world_from_camera.translation:
        voxels = metres * 1000.0 / voxel_mm
        whole = math.floor(voxels)
        fraction = round((voxels - whole) * (1 << 46))
        b.append(whole)
        c.append(fraction)
    slope_x, slope_y = int(np.abs(rays.x).max()), int(np.abs(rays.y).max())
    for axis in range(3):
        reach = MAX_MILLIMETRES * (abs(a[axis][0]) * slope_x + abs(a[axis][1]) * slope_y + (abs(a[axis][2]) << 18))
        if reach >= 1 << 62:
            raise InputError(
                f"a voxel of {voxel_size * 1000:g} mm is too small for this camera's field of view; "
                "choose a larger map.voxel_size"
            )
        extent = (reach * max_depth_mm // MAX_MILLIMETRES >> 46) + 2
        if abs(b[axis]) + extent >= RANGE:
            position = ", ".join(f"{value:.0f}" for value in world_from_camera.translation)
            raise InputError(
                f"the camera at ({position}) m is beyond the map's range of {RANGE * voxel_size / 1000:.0f} km; "
                "ingest again with --origin X,Y,Z (whole metres near the start of the path)"
            )
    return VoxelTransform(np.array(a, np.int64), np.array(b, np.int64), np.array(c, np.int64))


def color_lookup(rig: Rig, rays: Rays) -> ColorLookup:
    """What the integer look-up of a depth pixel in the colour camera's picture needs.

    rays: of the depth camera. Raises InputError where 63 bits would not do."""
    rows, (tx, ty, tz) = rig.depth_from_color.rotation(), rig.depth_from_color.translation
    inverse = [[rows[j][i] for j in range(3)] for i in range(3)]
    moved = [-(row[0] * tx + row[1] * ty + row[2] * tz) * 1000.0 for row in inverse]
    if max(abs(value) for value in moved) > 65_000:
        raise InputError("the colour camera is more than 65 m away from the depth camera; expected one device")
    slope = 1.0 + float(np.abs(rays.x).max() + np.abs(rays.y).max()) / (1 << 18)
    farthest = (MAX_MILLIMETRES * slope + max(abs(value) for value in moved)) * (1 << 16)
    pixels = max(rig.color.fx, rig.color.fy) + max(abs(rig.color.cx), abs(rig.color.cy))
    if farthest * (1 << 28) >= 1 << 63 or 2 * farthest * pixels * (1 << 16) + farthest * (1 << 16) >= 1 << 63:
        raise InputError(
            f"the look-up between a depth camera with rays of slope {slope - 1:.1f} and a colour camera of focal "
            f"length {rig.color.fx:.0f} does not fit 63 bits; register depth to colour before ingesting"
        )
    return ColorLookup(
        np.array([[round(value * (1 << 26)) for value in row] for row in inverse], np.int64),
        np.array([round(value * (1 << 44)) for value in moved], np.int64),
        *(round(value * (1 << 16)) for value in (rig.color.fx, rig.color.fy, rig.color.cx, rig.color.cy)),
    )
