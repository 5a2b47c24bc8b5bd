"""Where pictures are taken from: the colour camera of a frame, or a place above a room from which all is seen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Frame, Intrinsics

Points = NDArray[np.float64]
"""(n, 3), metres, world."""
ELEVATION = math.radians(40)
FILL = 0.45
"""Half of the picture's sides that may be filled."""


def world_from_color(frame: Frame) -> NDArray[np.float64]:
    """(4, 4) camera-to-world pose of the frame's colour camera."""
    pose: NDArray[np.float64] = frame.world_from_depth.matrix() @ frame.rig.depth_from_color.matrix()
    return pose


def from_above(points: Points, camera: Intrinsics, azimuth: float) -> NDArray[np.float64]:
    """(4, 4) camera-to-world pose that looks down at the points and just holds them all.

    azimuth: radians from the world's x axis to the side on which the camera stands. z is up.
    """
    level = math.cos(ELEVATION)
    forward = -np.array([math.cos(azimuth) * level, math.sin(azimuth) * level, math.sin(ELEVATION)])
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    local = points @ rotation
    eye = np.array([*_centre(local[:, :2]), local[:, 2].min() - 1.0])
    for _ in range(4):  # how far away depends on the centre, and the centre on perspective
        aside = np.abs(local[:, :2] - eye[:2]) * (camera.fx / (FILL * camera.width), camera.fy / (FILL * camera.height))
        eye[2] = (local[:, 2] - aside.max(1)).min()
        depth = (local[:, 2] - eye[2])[:, None]
        eye[:2] += _centre((local[:, :2] - eye[:2]) / depth) * float(depth.mean())
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ eye
    return pose


def _centre(points: NDArray[np.float64]) -> NDArray[np.float64]:
    centre: NDArray[np.float64] = (points.min(0) + points.max(0)) / 2
    return centre
