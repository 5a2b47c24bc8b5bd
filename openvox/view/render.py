"""What a camera sees of a voxel map: for every pixel the first voxel that its ray meets. Exact for cubes.

A ray crosses the grid monotonically in every axis, so each cell that it enters lies one step further from the eye's
cell in Manhattan distance. Voxels painted in that order, nearest first, need no depth buffer: the first one that a
pixel's ray meets keeps the pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from openvox.core.types import Intrinsics

NEAR = 0.1
"""Metres: what lies before this plane is not drawn, so that a voxel around the camera does not cover the picture."""
NOTHING = -1


def render_rows(
    voxel_index: NDArray[np.int32], voxel_size: float, world_from_camera: NDArray[np.float64], camera: Intrinsics
) -> NDArray[np.int32]:
    """Row of the first voxel that each pixel sees, -1 = none; (height, width) int32.

    voxel_index: (N, 3) int32, floor(world / voxel_size). voxel_size: metres. world_from_camera: (4, 4) camera-to-world
    pose, camera axes x right, y down, z forward. camera: integer pixel coordinates are pixel centres. A ray along a
    face that two voxels share sees the nearer one, then the lower row.
    """
    eye = world_from_camera[:3, 3] / voxel_size
    rotation = np.ascontiguousarray(world_from_camera[:3, :3], np.float64)
    pinhole = (camera.fx, camera.fy, camera.cx, camera.cy)
    image = np.full((camera.height, camera.width), NOTHING, np.int32)
    near = NEAR / voxel_size
    rows, boxes = _in_view(voxel_index, eye, rotation, pinhole, image.shape, near)
    steps = np.abs(voxel_index[rows] - np.floor(eye).astype(np.int64)).sum(1)
    if len(steps) and steps.max() < 2**16:
        steps = steps.astype(np.uint16)  # numpy sorts 16-bit keys by radix: five times faster
    order = np.argsort(steps, kind="stable")
    _paint(voxel_index, rows[order], boxes[order], eye, rotation, pinhole, near, image)
    return image


def render_map(
    voxel_index: NDArray[np.int32],
    labels: NDArray[np.int32],
    voxel_size: float,
    world_from_camera: NDArray[np.float64],
    camera: Intrinsics,
) -> NDArray[np.int32]:
    """Label of the first voxel that each pixel sees (0 = a background voxel), -1 = none; (height, width) int32.

    labels: (N,) int32, one a voxel; the rest as in `render_rows`.
    """
    return take_rows(labels, render_rows(voxel_index, voxel_size, world_from_camera, camera), np.int32(NOTHING))


def take_rows(values: NDArray[Any], rows: NDArray[np.int32], nothing: Any) -> NDArray[Any]:
    """The value of each pixel's voxel, `nothing` where it sees none. rows: an image of `render_rows`."""
    return np.append(values, np.asarray(nothing, values.dtype))[rows]  # row -1 is the value appended


@njit(cache=True, nogil=True, error_model="numpy")
def _in_view(index, eye, rotation, pinhole, shape, near):  # type: ignore[no-untyped-def]
    """Rows of the voxels that may be seen, and the pixels (u0, v0, u1, v1; exclusive) that their cubes reach."""
    fx, fy, cx, cy = pinhole
    height, width = shape
    rows = np.empty(len(index), np.int64)
    boxes = np.empty((len(index), 4), np.int32)
    n = 0
    for row in range(len(index)):
        dx, dy, dz = index[row, 0] - eye[0], index[row, 1] - eye[1], index[row, 2] - eye[2]
        z_low, z_high = np.inf, -np.inf
        u_low, v_low, u_high, v_high = np.inf, np.inf, -np.inf, -np.inf
        left, right, above, below = True, True, True, True  # all corners beyond that side of the picture
        for corner in range(8):
            x, y, z = dx + (corner & 1), dy + (corner >> 1 & 1), dz + (corner >> 2)
            forward = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
            right_of = fx * (rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z) + cx * forward
            down_of = fy * (rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z) + cy * forward
            left, right = left and right_of < -forward, right and right_of > width * forward
            above, below = above and down_of < -forward, below and down_of > height * forward
            z_low, z_high = min(z_low, forward), max(z_high, forward)
            u_low, u_high = min(u_low, right_of / forward), max(u_high, right_of / forward)
            v_low, v_high = min(v_low, down_of / forward), max(v_high, down_of / forward)
        if z_high < near or left or right or above or below:
            continue
        if z_low < near:  # a corner projects to nowhere: try every pixel
            u_low, v_low, u_high, v_high = 0.0, 0.0, width - 1.0, height - 1.0
        # a hundredth of a pixel against rounding; the ray itself decides
        boxes[n, 0], boxes[n, 1] = int(max(0.0, np.ceil(u_low - 0.01))), int(max(0.0, np.ceil(v_low - 0.01)))
        boxes[n, 2], boxes[n, 3] = int(min(width, np.floor(u_high + 1.01))), int(min(height, np.floor(v_high + 1.01)))
        if boxes[n, 0] < boxes[n, 2] and boxes[n, 1] < boxes[n, 3]:
            rows[n] = row
            n += 1
    return rows[:n], boxes[:n]


@njit(cache=True, nogil=True, error_model="numpy")
def _paint(index, rows, boxes, eye, rotation, pinhole, near, image):  # type: ignore[no-untyped-def]
    """Give every free pixel to the first of `rows` whose cube its ray meets at or beyond the near plane."""
    fx, fy, cx, cy = pinhole
    for k in range(len(rows)):
        row = rows[k]
        low = (index[row, 0] - eye[0], index[row, 1] - eye[1], index[row, 2] - eye[2])
        for v in range(boxes[k, 1], boxes[k, 3]):
            y = (v - cy) / fy
            for u in range(boxes[k, 0], boxes[k, 2]):
                if image[v, u] == NOTHING:
                    x = (u - cx) / fx
                    enter, leave = near, np.inf  # depth along the camera's z axis
                    for a in range(3):
                        step = rotation[a, 0] * x + rotation[a, 1] * y + rotation[a, 2]
                        first, second = low[a] / step, (low[a] + 1) / step
                        if first > second:
                            first, second = second, first
                        if first > enter:  # false for 0 / 0: a ray in the plane of a face touches the cube
                            enter = first
                        if second < leave:
                            leave = second
                    if enter <= leave:
                        image[v, u] = row
