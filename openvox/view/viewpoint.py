"""Where pictures are taken from: the colour camera of a frame, or a place above a room from which all is seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Frame, InstanceMap, Intrinsics
from openvox.view.render import render_map

Points = NDArray[np.float64]
"""(n, 3), metres, world."""
Shown = Callable[[InstanceMap, float], NDArray[np.bool_]]
AZIMUTHS = 8
NEAREST = 0.5
"""Metres between the camera and the nearest point, however small the map."""
ELEVATION = math.radians(40)
FILL = 0.45
"""Half of the picture's sides that may be filled."""


def world_from_color(frame: Frame) -> NDArray[np.float64]:
    """(4, 4) camera-to-world pose of the frame's colour camera."""
    pose: NDArray[np.float64] = frame.world_from_depth.matrix() @ frame.rig.depth_from_color.matrix()
    return pose


def narrow_camera(width: int, height: int) -> Intrinsics:
    """With a long lens, so that parallel edges stay nearly parallel."""
    return Intrinsics(width, height, 1.8 * width, 1.8 * width, (width - 1) / 2, (height - 1) / 2)


def centres(index: NDArray[np.int32], voxel_size: float) -> Points:
    """Middles of voxels, metres; the origin if there are none."""
    return np.asarray((index + 0.5) * voxel_size, np.float64) if len(index) else np.zeros((1, 3))


def best_azimuth(result: InstanceMap, shown: Shown, wanted: Sequence[int] = ()) -> float:
    """The side from which most is seen, of many instances rather than of one; the first among equals.

    shown: what of the map is drawn from an azimuth. wanted: ids of the instances that count, without them all.
    """
    camera = narrow_camera(160, 100)
    seen = []
    for turn in range(AZIMUTHS):
        azimuth = 2 * math.pi * (turn + 0.4) / AZIMUTHS  # not along the walls
        kept = shown(result, azimuth)
        index = result.voxel_index[kept]
        pose = from_above(centres(index, result.voxel_size), camera, azimuth)
        labels = render_map(index, result.voxel_instance[kept], result.voxel_size, pose, camera)
        counted = np.isin(labels, list(wanted)) if wanted else labels > 0
        pixels = np.unique(labels[counted], return_counts=True)[1]
        seen.append((float(np.sqrt(pixels).sum()), -turn, azimuth))
    return max(seen)[2]


def from_above(points: Points, camera: Intrinsics, azimuth: float, elevation: float = ELEVATION) -> NDArray[np.float64]:
    """(4, 4) camera-to-world pose that looks down at the points and just holds them all.

    azimuth: radians from the world's x axis to the side on which the camera stands; elevation: from the level up.
    z is up.
    """
    level = math.cos(elevation)
    forward = -np.array([math.cos(azimuth) * level, math.sin(azimuth) * level, math.sin(elevation)])
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    local = points @ rotation
    eye = np.array([*_middle(local[:, :2]), local[:, 2].min() - 1.0])
    for _ in range(4):  # how far away depends on the centre, and the centre on perspective
        aside = np.abs(local[:, :2] - eye[:2]) * (camera.fx / (FILL * camera.width), camera.fy / (FILL * camera.height))
        eye[2] = (local[:, 2] - np.maximum(aside.max(1), NEAREST)).min()
        depth = (local[:, 2] - eye[2])[:, None]
        eye[:2] += _middle((local[:, :2] - eye[:2]) / depth) * float(depth.mean())
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ eye
    return pose


def _middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    middle: NDArray[np.float64] = (points.min(0) + points.max(0)) / 2
    return middle
