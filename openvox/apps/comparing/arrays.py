"""The first number in which two maps differ, in the order of the map digest."""

from __future__ import annotations

from typing import Any

import numpy as np

from openvox.core.types import InstanceMap

ARRAYS = (
    *("voxel_index", "vote_offset", "vote_fragment", "vote_count", "fragment_id", "fragment_instance"),
    *("voxel_instance", "instance_id", "feature"),
)
"""What the map digest covers."""


def first_difference(a: InstanceMap, b: InstanceMap) -> dict[str, Any] | None:
    """`field`, `row` and both values (None where an array has ended); None if the maps are equal."""
    for name in ("voxel_size", "vote_unit"):
        if getattr(a, name) != getattr(b, name):
            return {"field": name, "row": None, "a": getattr(a, name), "b": getattr(b, name)}
    for name in ARRAYS:
        one, other = getattr(a, name), getattr(b, name)
        if one.shape[1:] != other.shape[1:]:
            return {"field": name, "row": None, "a": list(one.shape), "b": list(other.shape)}
        shared = min(len(one), len(other))
        apart = (one[:shared] != other[:shared]).reshape(shared, -1).any(1)
        if apart.any() or len(one) != len(other):
            row = int(np.argmax(apart)) if apart.any() else shared
            return {"field": name, "row": row, "a": _at(one, row), "b": _at(other, row)}
    return None


def _at(array: np.ndarray[Any, Any], row: int) -> Any:
    return array[row].tolist() if row < len(array) else None
