"""A map as the page's scene reads it: the cells that can be seen, with the faces that no neighbour covers."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.view.faces import open_faces
from openvox.view.pictures import CEILING_METRES, FLOOR_METRES, floor_and_ceiling

MOST_CELLS = 200_000
"""More are joined, eight to one, until no more are left: a phone can turn so many, and the page stays small."""
SPAN = 1 << 16
CELL = np.dtype([("x", "<u2"), ("y", "<u2"), ("z", "<u2"), ("place", "<u2"), ("faces", "u1"), ("confidence", "u1")])
"""place: 0 = background, else 1 + row of the instance. faces: bit 2 x axis + 1 if upper. confidence: of 255."""


def scene(result: InstanceMap) -> dict[str, Any]:
    """The cells in base64 and what is needed to place them. Raises InputError for too many instances."""
    if len(result.instance_id) >= SPAN:
        raise InputError(f"the map has {len(result.instance_id)} instances; a page shows up to {SPAN - 1}")
    index, instance, confidence, joined = _coarse(result)
    faces = open_faces(index, instance)
    seen = faces > 0
    low = index.min(0) if len(index) else np.zeros(3, np.int64)
    cells = np.zeros(int(seen.sum()), CELL)
    for axis, name in enumerate("xyz"):
        cells[name] = (index[seen] - low)[:, axis]
    cells["place"] = np.where(instance[seen] > 0, np.searchsorted(result.instance_id, instance[seen]) + 1, 0)
    cells["faces"] = faces[seen]
    cells["confidence"] = np.rint(confidence[seen] * 255)
    size = result.voxel_size * joined
    floor, ceiling = _cut(index[instance == 0, 2] - low[2], size)
    return {
        "cells": base64.b64encode(cells.tobytes()).decode(),
        "low": low.tolist(),
        "size": size,
        "joined": joined,
        "floor": floor,
        "ceiling": ceiling,
        "ids": result.instance_id.tolist(),
    }


def _coarse(
    result: InstanceMap,
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32], int]:
    """Cell index (n, 3), instance, confidence, and the edge of a cell in voxels: a power of 2.

    A cell shows the surest voxel of an instance in it, else background.
    """
    index, joined = result.voxel_index.astype(np.int64), 1
    instance, confidence = result.voxel_instance, result.voxel_confidence
    while len(index) > MOST_CELLS or (len(index) and (index.max(0) - index.min(0)).max() >= SPAN):
        index, joined = index >> 1, joined * 2
        order = np.lexsort((-confidence, instance == 0, index[:, 2], index[:, 1], index[:, 0]))
        index = index[order]
        first = np.ones(len(index), np.bool_)
        first[1:] = (index[1:] != index[:-1]).any(1)
        index, instance, confidence = index[first], instance[order][first], confidence[order][first]
    return index, instance, confidence, joined


def _cut(level: NDArray[np.int64], size: float) -> tuple[float, float]:
    """Up to which cell background is floor, and from which on it is ceiling."""
    if not len(level):
        return 0.0, float(SPAN)
    floor, ceiling = floor_and_ceiling(level)
    return floor + FLOOR_METRES / size, float(min(ceiling - CEILING_METRES / size, SPAN))
