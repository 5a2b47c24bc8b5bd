"""A voxel is floor(world / voxel_size) in each axis; its key packs the three indices into 63 bits, so that ascending
keys are ascending x, then y, then z."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

RANGE = 1 << 20
"""Voxel indices lie in -RANGE .. RANGE - 1."""


def voxel_key(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 3) voxel indices to (n,) keys of three 21-bit fields."""
    shifted = index + RANGE
    packed: NDArray[np.int64] = (shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2]
    return packed


def voxel_index(key: NDArray[np.int64]) -> NDArray[np.int32]:
    """(n,) keys to (n, 3) voxel indices."""
    field = (1 << 21) - 1
    return np.stack([(key >> 42) - RANGE, ((key >> 21) & field) - RANGE, (key & field) - RANGE], 1).astype(np.int32)


def rows_of(keys: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Row of each wanted key among the ascending keys, -1 if there is none."""
    where = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[where] == wanted, where, -1)
