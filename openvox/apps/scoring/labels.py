"""From voxels to points: which label of a map each point of the truth gets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import InstanceMap

REACH = 1.5
"""Voxel edges between a point and the centre of the nearest voxel that may label it."""
NONE = -1
_LIMIT = 1 << 20
_TIE = 1e-9


def rows_at_points(points: NDArray[np.float64], result: InstanceMap, reach: float = REACH) -> NDArray[np.int64]:
    """Row of the voxel that speaks for each point, -1 = none; (N,) int64.

    The voxel that contains the point, if the map holds it; else the nearest whose centre lies within `reach` edges,
    the lower row on a tie. reach 0: the containing voxel only. points: (N, 3) metres.
    """
    rows = np.full(len(points), NONE, np.int64)
    if not len(points) or not len(result.voxel_index):
        return rows
    cell = np.floor(points / result.voxel_size)
    inside = np.all((cell >= -_LIMIT) & (cell < _LIMIT), axis=1)
    held = _keys(result.voxel_index)
    wanted = _keys(np.where(inside[:, None], cell, 0).astype(np.int64))
    place = np.minimum(np.searchsorted(held, wanted), len(held) - 1)
    hit = inside & (held[place] == wanted)
    rows[hit] = place[hit]
    rest = np.flatnonzero(~hit)
    if reach > 0 and len(rest):
        rows[rest] = _nearest(points[rest] / result.voxel_size - 0.5, result.voxel_index, reach)
    return rows


def labels_of_rows(rows: NDArray[np.int64], result: InstanceMap) -> NDArray[np.int64]:
    """Instance of each row's voxel, 0 = background or no voxel."""
    return np.append(result.voxel_instance, 0)[rows].astype(np.int64)  # row -1 is the 0 appended


def _nearest(places: NDArray[np.float64], index: NDArray[np.int32], reach: float) -> NDArray[np.int64]:
    """Row of the nearest cell, -1 if none is within reach. places: (N, 3), cell centres are whole numbers."""
    from scipy.spatial import cKDTree

    tree = cKDTree(index.astype(np.float64))
    distance, row = tree.query(places, k=2, distance_upper_bound=reach + _TIE)
    with np.errstate(invalid="ignore"):  # infinity - infinity where neither is there
        tie = distance[:, 1] - distance[:, 0] < _TIE
    nearest = np.where(tie, row.min(1), row[:, 0])
    return np.where(np.isfinite(distance[:, 0]), nearest, NONE).astype(np.int64)


def _keys(index: NDArray[np.int32] | NDArray[np.int64]) -> NDArray[np.int64]:
    """One number a cell, ascending by x, then y, then z."""
    x, y, z = index.astype(np.int64).T
    return np.asarray((x << 42) + (y << 21) + z)
