"""The equations of the OpenVox paper, one function each, in integers.

Written for scalars and arrays alike; the engines compile the same functions into their kernels.
Scores are in Q20 (parts of 2**20), credibility and codebook weights in Q12.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint

FULL_WEIGHT = 1 << 12
"""Credibility 1 in Q12: the weight with which a new instance's first feature enters the codebook."""


def count_votes(alpha: Any, votes: Any) -> Any:
    """alpha_t = alpha_(t-1) + y_t, eq. (14): the instance counting sensor model.

    alpha, votes: int, counts of one id in one voxel before the frame and in it."""
    return alpha + votes


def instance_vector(alpha: Any, total: Any) -> Any:
    """theta, eq. (15): one id's share of all counts of a voxel, in Q20.

    alpha, total: int64, total > 0."""
    return (alpha << 20) // total


def geometric_similarity(theta_sum: int, voxels: int) -> int:
    """S_geo, eq. (8): mean of theta over all voxels of a mask, in Q20; voxels that hold no count add 0.

    theta_sum: sum of theta in Q20 over the mask's voxels. voxels: |V_m| > 0."""
    return theta_sum // voxels


def feature_similarity(dot: int, square_instance: int, square_mask: int) -> int:
    """S_fea, eq. (9): cosine of an instance's codebook feature and a mask's caption feature, in Q20."""
    return fixedpoint.cosine(dot, square_instance, square_mask)


def association_probability(s_geo: int, s_fea: int, weight_geometry: int, weight_feature: int) -> int:
    """A: weighted fusion of both similarities (the text after (9)), in Q20; weights in parts of a million."""
    return (weight_geometry * s_geo + weight_feature * s_fea) // fixedpoint.MILLION


def visibility_ratio(voxels: int, instance_voxels: int) -> int:
    """R, eq. (17): the mask's voxels over the instance's before the frame, in Q20, clipped to 1; 1 if it owns none."""
    if instance_voxels == 0:
        return fixedpoint.Q20
    return min(fixedpoint.Q20, (voxels << 20) // instance_voxels)


def credibility(association: int, visibility: int) -> int:
    """w = A R, eq. (16), in Q12, never below 0; association and visibility in Q20."""
    return max(0, association * visibility >> 28)


def fused_feature(total: NDArray[np.int64], weight: int, feature: NDArray[np.int64]) -> NDArray[np.int64]:
    """Running weighted mean of caption features, eq. (18), kept as the sum W f: (D,) int64.

    The division by W is left to the export, so that nothing is ever rounded."""
    return total + weight * feature


def fused_weight(total: int, weight: int) -> int:
    """W_t = W_(t-1) + w_t, eq. (19), in Q12."""
    return total + weight
