"""Voxels as lit cubes: a picture in which shapes are seen, not only labels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Intrinsics
from openvox.view.render import NOTHING

LIGHT = np.array([[0.80, 0.66], [0.72, 0.88], [0.50, 1.00]], np.float32)
"""Brightness of the faces across x, y and z: the lower and the upper one."""
NO_FACE = 6
EDGE = 0.93
OUTLINE = 0.62
"""Brightness where one face, and where one label, ends."""


def lit(
    colors: NDArray[np.uint8],
    rows: NDArray[np.int32],
    voxel_index: NDArray[np.int32],
    labels: NDArray[np.int32],
    voxel_size: float,
    world_from_camera: NDArray[np.float64],
    camera: Intrinsics,
) -> NDArray[np.uint8]:
    """Each pixel's color, darkened by the direction of the face that it sees; (height, width, 3) uint8.

    colors: (height, width, 3). rows: image of `render_rows` from the same pose, labels: image of any labels.
    """
    face = np.where(rows == NOTHING, NO_FACE, _faces(rows, voxel_index, voxel_size, world_from_camera, camera))
    light = np.append(LIGHT.ravel(), np.float32(1.0))[face]
    for across in (0, 1):
        before, after = [slice(None)] * 2, [slice(None)] * 2
        before[across], after[across] = slice(None, -1), slice(1, None)
        a, b = tuple(before), tuple(after)
        light[a][(rows[a] != rows[b]) | (face[a] != face[b])] *= EDGE
        light[a][labels[a] != labels[b]] *= OUTLINE
    shaded: NDArray[np.uint8] = (colors * light[..., None]).astype(np.uint8)
    return shaded


def _faces(
    rows: NDArray[np.int32],
    voxel_index: NDArray[np.int32],
    voxel_size: float,
    world_from_camera: NDArray[np.float64],
    camera: Intrinsics,
) -> NDArray[np.int64]:
    """Which face of its cube each pixel's ray enters: 2 x axis + 1 if it is the upper one; (height, width)."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    direction = (rays @ world_from_camera[:3, :3].T).astype(np.float32)
    upper = direction < 0
    plane = (voxel_index[rows] + upper) * voxel_size - world_from_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        entered = np.where(direction == 0, -np.inf, plane / direction)
    axis = entered.argmax(-1)
    faces: NDArray[np.int64] = 2 * axis + np.take_along_axis(upper, axis[..., None], -1)[..., 0]
    return faces
