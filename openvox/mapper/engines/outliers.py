"""A mask's voxels without those that lie apart, as the authors' code has it, in integers."""

from __future__ import annotations

from math import isqrt

import numpy as np
from numpy.typing import NDArray

from openvox.mapper.engines import neighbours

NEAREST = 10
"""Voxels, the voxel itself included, whose mean distance says how far apart a voxel lies."""
DEVIATIONS = 2


def inliers(
    index: NDArray[np.int32], pair_voxel: NDArray[np.int32], pair_mask: NDArray[np.int32], masks: int
) -> NDArray[np.bool_]:
    """Which (voxel, mask) pairs stay: those with a mean distance above 0 and below the mask's mean by two deviations.

    index: (n, 3) voxels of the frame. Pairs under no mask (mask == masks) stay."""
    kept = np.ones(len(pair_voxel), np.bool_)
    order = np.argsort(pair_mask, kind="stable")
    ends = np.searchsorted(pair_mask[order], np.arange(masks + 1))
    for mask in range(masks):
        here = order[ends[mask] : ends[mask + 1]]
        sums = neighbours.distance_sums(index[pair_voxel[here]].astype(np.int64), NEAREST)
        kept[here] = (sums > 0) & (sums * len(sums) - int(sums.sum()) <= _reach(sums))
    return kept


def _reach(sums: NDArray[np.int64]) -> int:
    """The largest n x - S that is below 2 n sd: sd is that of n numbers x with sum S, divided by n - 1."""
    n, total = len(sums), int(sums.sum())
    if n < 2:
        return -1
    spread = n * sum(int(x) ** 2 for x in sums.tolist()) - total**2  # n^2 times the variance
    square = DEVIATIONS**2 * n * spread
    return isqrt((square - 1) // (n - 1)) if square else -1
