"""Connected parts of a map: loose parts of things, and holes in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.voxels import rows_of, voxel_index, voxel_key

Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
HALF_NEIGHBOURS = tuple((i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0))
"""One of each opposite pair of the 26 neighbours."""


def without_loose_parts(shown: Longs, keys: Longs, least: float) -> Longs:
    """`shown` with 0 where a 26-connected part has less than this share of its instance's voxels."""
    part = np.arange(len(keys))
    rows = np.flatnonzero(shown > 0)
    index = voxel_index(keys[rows]).astype(np.int64)
    for step in HALF_NEIGHBOURS if len(rows) else ():
        other = rows_of(keys, voxel_key(index + np.array(step)))
        same = (other >= 0) & (shown[rows] == shown[other])
        part = _joined(part, rows[same], other[same])
    sizes, part_sizes = np.bincount(shown), np.bincount(part)
    loose = fixedpoint.MILLION * part_sizes[part] < fixedpoint.millionths(least) * sizes[shown]
    return np.where(loose, 0, shown)


def without_holes(shown: Longs, beside: Ints, most: float) -> Longs:
    """`shown` where each hole shows what it is a hole in: a patch of voxels without instance, connected by faces, that
    touches one instance alone and has at most this share of its voxels. beside: see smoothing.face_neighbours."""
    bare = shown == 0
    part = np.arange(len(shown))
    lowest, highest = np.full(len(shown), np.iinfo(np.int64).max), np.zeros(len(shown), np.int64)
    for face in beside:
        rows = np.flatnonzero(bare & (face >= 0))
        rows = rows[bare[face[rows]]]
        part = _joined(part, rows, face[rows].astype(np.int64))
    for face in beside:
        rows = np.flatnonzero(bare & (face >= 0))
        rows = rows[~bare[face[rows]]]
        np.minimum.at(lowest, part[rows], shown[face[rows]])
        np.maximum.at(highest, part[rows], shown[face[rows]])
    around = np.where(lowest == highest, highest, 0)
    sizes, part_sizes = np.bincount(shown), np.bincount(part[bare], minlength=len(shown))
    hole = fixedpoint.MILLION * part_sizes <= fixedpoint.millionths(most) * sizes[around]
    return np.where(bare & hole[part], around[part], shown)


def _joined(part: Longs, a: Longs, b: Longs) -> Longs:
    """The parts where those of rows a[i] and b[i] are one; a part is named by its lowest row, before and after."""
    while True:
        a, b = part[a], part[b]
        apart = a != b
        if not apart.any():
            return part
        a, b = a[apart], b[apart]
        np.minimum.at(part, np.maximum(a, b), np.minimum(a, b))
        while not np.array_equal(part, lower := part[part]):
            part = lower
