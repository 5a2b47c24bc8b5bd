"""Points of the surface that depth pictures saw, one a 2 cm cell and instance; compiled: it looks at every pixel."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics

CELL = 0.02
"""Metres: one point is kept a cell and instance."""
_RANGE = 1 << 16
"""Cells along each axis, the first point in the middle: 655 m to each side."""
_EMPTY = np.uint64(0)
_OUTSIDE = -1


class Surface:
    """Points so far: the first in its cell and instance, by frame and then by pixel. Memory grows with the surface."""

    def __init__(self) -> None:
        self._origin: NDArray[np.int64] | None = None
        self._table = np.zeros(1 << 16, np.uint64)
        self._used = 0
        self._parts: list[tuple[NDArray[np.float64], NDArray[np.int64]]] = []

    def add(self, frame: Frame) -> None:
        """The new points of a frame with truth pictures, under the ids and categories of its colour pixels."""
        ids, kinds = frame.truth_instances, frame.truth_categories
        if ids is None or not frame.depth.any():
            return
        if 2 * (self._used + frame.depth.size) > len(self._table):
            bigger = np.zeros(2 ** (4 * (self._used + frame.depth.size)).bit_length(), np.uint64)
            _refill(self._table, bigger)
            self._table = bigger
        color_from_depth = np.linalg.inv(frame.rig.depth_from_color.matrix())
        world_from_depth = frame.world_from_depth.matrix()
        cameras = (_numbers(frame.rig.depth), _numbers(frame.rig.color))
        if self._origin is None:
            self._origin = np.floor(world_from_depth[:3, 3] / CELL).astype(np.int64) - _RANGE // 2
        points, labels = np.empty((frame.depth.size, 3)), np.empty((frame.depth.size, 2), np.int64)
        n = _new_points(
            *(frame.depth, ids, np.zeros_like(ids) if kinds is None else kinds),
            *(world_from_depth, color_from_depth, cameras, frame.rig.registered),
            *(self._origin, self._table, points, labels),
        )
        if n == _OUTSIDE:
            raise InputError(
                f"frame {frame.index} sees a point more than {_RANGE // 2 * CELL:.0f} m from where the first one "
                "was taken; score so large a map against a folder with gt_points.npz"
            )
        self._used += n
        self._parts.append((np.round(points[:n], 3), labels[:n].copy()))

    def result(self) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Points (N, 3) metres, rounded to 1 mm; instance (N,), 0 = background; category (N,)."""
        points = np.concatenate([np.zeros((0, 3)), *(points for points, _ in self._parts)])
        labels = np.concatenate([np.zeros((0, 2), np.int64), *(labels for _, labels in self._parts)])
        return points, labels[:, 0], labels[:, 1]


def _numbers(camera: Intrinsics) -> tuple[float, float, float, float]:
    return camera.fx, camera.fy, camera.cx, camera.cy


@njit(cache=True, nogil=True)
def _new_points(depth, ids, kinds, world, color, cameras, registered, origin, table, points, labels):  # type: ignore[no-untyped-def]
    """Fill points and labels (instance, category) with what is not in the table yet; their number."""
    (fx, fy, cx, cy), (fu, fv, cu, cv) = cameras
    n = 0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u] / 1000.0
            if z == 0.0:
                continue
            x, y = (u - cx) / fx * z, (v - cy) / fy * z
            row, column = v, u
            if not registered:
                forward = color[2, 0] * x + color[2, 1] * y + color[2, 2] * z + color[2, 3]
                if forward <= 0.0:
                    continue
                right = color[0, 0] * x + color[0, 1] * y + color[0, 2] * z + color[0, 3]
                down = color[1, 0] * x + color[1, 1] * y + color[1, 2] * z + color[1, 3]
                at_u, at_v = np.floor(right / forward * fu + cu + 0.5), np.floor(down / forward * fv + cv + 0.5)
                if at_u < 0 or at_v < 0 or at_u >= ids.shape[1] or at_v >= ids.shape[0]:
                    continue
                row, column = int(at_v), int(at_u)
            key = np.uint64(0)
            for a in range(3):
                points[n, a] = world[a, 0] * x + world[a, 1] * y + world[a, 2] * z + world[a, 3]
                cell = np.int64(np.floor(points[n, a] / CELL)) - origin[a]
                if cell < 1 or cell >= _RANGE:
                    return _OUTSIDE
                key = (key << np.uint64(16)) | np.uint64(cell)  # never 0, the empty place
            if _insert(table, (key << np.uint64(16)) | np.uint64(ids[row, column])):
                labels[n, 0], labels[n, 1] = ids[row, column], kinds[row, column]
                n += 1
    return n


@njit(cache=True, nogil=True)
def _insert(table, key):  # type: ignore[no-untyped-def]
    """True if the key was not there; linear probing, the table is at most half full."""
    mask = np.uint64(len(table) - 1)
    place = ((key * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20)) & mask
    while table[place] != _EMPTY:
        if table[place] == key:
            return False
        place = (place + np.uint64(1)) & mask
    table[place] = key
    return True


@njit(cache=True, nogil=True)
def _refill(table, bigger):  # type: ignore[no-untyped-def]
    for key in table:
        if key != _EMPTY:
            _insert(bigger, key)
