"""What query, export and info say about the instances of a map."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import InstanceMap
from openvox.formats.map_npz import summary_as_dict


def described(result: InstanceMap) -> list[dict[str, Any]]:
    """One object an instance, by id: the map's summary, confidence and centre. Metres."""
    return [
        {
            "instance": summary.id,
            **summary_as_dict(summary),
            "confidence": float(confidence),
            "center": [float(x) for x in center],
        }
        for summary, confidence, center in zip(
            result.instances, result.instance_confidence, centers(result), strict=True
        )
    ]


def centers(result: InstanceMap) -> NDArray[np.float64]:
    """(K, 3): mean of the voxels' centres of each instance, metres; the middle of its bounds if it has no voxel."""
    middles = np.array([np.mean(summary.bounds, axis=0) for summary in result.instances]).reshape(-1, 3)
    row = np.searchsorted(result.instance_id, result.voxel_instance)
    mine = result.voxel_instance > 0
    count = np.bincount(row[mine], minlength=len(middles))
    sums = [np.bincount(row[mine], axis, len(middles)) for axis in voxel_centers(result)[mine].T]
    means = np.stack(sums, 1) / np.maximum(count, 1)[:, None]
    return np.where(count[:, None] > 0, means, middles)


def voxel_centers(result: InstanceMap) -> NDArray[np.float64]:
    """(N, 3) metres."""
    return np.asarray((result.voxel_index + 0.5) * result.voxel_size, np.float64)
