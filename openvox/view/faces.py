"""The faces of voxels that can be seen: those that no neighbour of the same label covers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def open_faces(index: NDArray[np.integer], labels: NDArray[np.int32]) -> NDArray[np.uint8]:
    """(N,) the faces of each cell behind which no cell of the same label lies: bit 2 x axis, + 1 for the upper one.

    index: (N, 3), ascending by x, then y, then z, as in a map. labels: (N,)."""
    index = index.astype(np.int64)
    low = index.min(0) - 1 if len(index) else np.zeros(3, np.int64)
    steps = np.array([1 << 42, 1 << 21, 1])
    key = (index - low) @ steps
    faces = np.zeros(len(index), np.uint8)
    for axis in range(3):
        for upper in (0, 1):
            beside = key + (2 * upper - 1) * steps[axis]
            at = np.minimum(np.searchsorted(key, beside), max(len(key) - 1, 0))
            covered = (key[at] == beside) & (labels[at] == labels)
            faces |= np.where(covered, 0, 1 << (2 * axis + upper)).astype(np.uint8)
    return faces
