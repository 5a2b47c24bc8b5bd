"""Is a voxel's confidence the share of voxels like it that are right?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.apps.scoring.instances import Overlaps

BINS = 10


def expected_calibration_error(
    truth: NDArray[np.int64], labels: NDArray[np.int64], confidence: NDArray[np.float64]
) -> float | None:
    """Mean over labelled points of |share that is right - mean confidence| of the point's bin; None without any.

    truth, labels: (N,) ids, 0 = none; confidence: (N,) of each point's voxel, 0 .. 1. Right is a point of the true
    object that has most of its instance's points (the lowest id on a tie). Ten equal bins, the upper one at an edge.
    """
    overlaps = Overlaps.count(truth, labels)
    labelled = labels > 0
    n = int(labelled.sum())
    if not n:
        return None
    if len(overlaps.true_ids):
        main = np.where(overlaps.shared.max(0) > 0, overlaps.true_ids[np.argmax(overlaps.shared, 0)], -1)
    else:
        main = np.full(len(overlaps.ids), -1)
    right = truth[labelled] == main[np.searchsorted(overlaps.ids, labels[labelled])]
    sure = confidence[labelled]
    which = np.minimum((sure * BINS).astype(np.int64), BINS - 1)
    gap = np.bincount(which, right, BINS) - np.bincount(which, sure, BINS)
    return float(np.abs(gap).sum() / n)
