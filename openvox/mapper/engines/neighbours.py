"""Distances between the voxels of a mask: a kernel for the host."""

from __future__ import annotations

import numpy as np

from openvox.mapper.engines.compiled import kernel

REACH = 2
"""The search looks into cubes of at most so many voxels around, then at all voxels."""


@kernel
def root(square):
    """Integer square root."""
    x = np.int64(np.sqrt(np.float64(square)))
    while x * x > square:
        x -= 1
    while (x + 1) * (x + 1) <= square:
        x += 1
    return x


@kernel
def keep_smallest(best, found, square):
    """Enter a squared distance into the ascending ones, if it is among the smallest; returns how many there are."""
    n = min(found, best.size)
    if n == best.size and square >= best[n - 1]:
        return found
    at = min(n, best.size - 1)
    while at > 0 and best[at - 1] > square:
        best[at] = best[at - 1]
        at -= 1
    best[at] = square
    return n + 1


@kernel
def distance_sums(index, nearest):
    """Sum of the distances, in 1/1024 voxels, of each voxel to its `nearest` voxels, itself included, or to all if
    there are fewer. index: (n, 3) int64, distinct."""
    n = index.shape[0]
    out = np.zeros(n, np.int64)
    if n == 0:
        return out
    low = np.array([index[:, a].min() for a in range(3)]) - REACH
    extent = np.array([index[:, a].max() for a in range(3)]) + REACH + 1 - low
    cells = extent[0] * extent[1] * extent[2]
    dense = cells <= 1 << 24
    there = np.zeros(cells if dense else 1, np.bool_)
    place = ((index[:, 0] - low[0]) * extent[1] + index[:, 1] - low[1]) * extent[2] + index[:, 2] - low[2]
    if dense:
        for i in range(n):
            there[place[i]] = True
    best = np.empty(min(nearest, n), np.int64)
    for i in range(n):
        found = 0
        if dense:
            for x in range(-REACH, REACH + 1):
                for y in range(-REACH, REACH + 1):
                    for z in range(-REACH, REACH + 1):
                        if there[place[i] + (x * extent[1] + y) * extent[2] + z]:
                            found = keep_smallest(best, found, x * x + y * y + z * z)
        if found < best.size or best[best.size - 1] > REACH * REACH:
            found = 0
            for j in range(n):
                x, y, z = index[i, 0] - index[j, 0], index[i, 1] - index[j, 1], index[i, 2] - index[j, 2]
                found = keep_smallest(best, found, x * x + y * y + z * z)
        for j in range(best.size):
            out[i] += root(best[j] << 20)
    return out
