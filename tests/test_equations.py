"""The paper's equations, with numbers by hand. Scores in parts of 2**20, credibility in parts of 2**12."""

from __future__ import annotations

import numpy as np
import pytest

from openvox.core.fixedpoint import Q20, cosine, millionths, q20, quantised, shortened
from openvox.mapper import equations


def test_votes_are_counted() -> None:
    assert equations.count_votes(3, 2) == 5


def test_theta_is_a_share_of_all_votes() -> None:
    assert equations.instance_vector(1, 4) == Q20 // 4
    assert equations.instance_vector(1, 3) == 349525  # 2**20 / 3, rounded down


def test_geometric_similarity_is_a_mean_in_which_unseen_voxels_count_as_zero() -> None:
    # two voxels of theta 1 and 0.5 in a mask of four
    assert equations.geometric_similarity(Q20 + Q20 // 2, 4) == Q20 * 3 // 8


@pytest.mark.parametrize(
    ("a", "b", "expected"), [((3, 4), (3, 4), Q20), ((1, 0), (0, 5), 0), ((1, 0), (-2, 0), -Q20), ((0, 0), (1, 1), 0)]
)
def test_feature_similarity_is_a_cosine(a: tuple[int, int], b: tuple[int, int], expected: int) -> None:
    x, y = np.array(a), np.array(b)
    assert equations.feature_similarity(int(x @ y), int(x @ x), int(y @ y)) == expected


def test_feature_similarity_of_sixty_degrees_is_a_half() -> None:
    assert equations.feature_similarity(1, 2, 2) == Q20 // 2


def test_association_probability_weighs_both() -> None:
    assert equations.association_probability(1000, 500, millionths(0.8), millionths(0.2)) == 900
    assert equations.association_probability(0, -7, millionths(0.8), millionths(0.2)) == -2  # -1.4, rounded down


@pytest.mark.parametrize(("voxels", "of", "expected"), [(1, 4, Q20 // 4), (9, 4, Q20), (3, 0, Q20)])
def test_visibility_is_clipped_to_one_and_one_where_nothing_is_owned(voxels: int, of: int, expected: int) -> None:
    assert equations.visibility_ratio(voxels, of) == expected


def test_credibility_is_the_product_and_never_below_zero() -> None:
    assert equations.credibility(Q20 // 2, Q20 // 2) == 1024  # a quarter of 4096
    assert equations.credibility(-Q20, Q20) == 0


def test_the_codebook_is_a_weighted_sum_that_nothing_rounds() -> None:
    total = equations.fused_feature(np.array([4096, 0]), 1024, np.array([0, 127]))
    assert total.tolist() == [4096, 1024 * 127]
    assert equations.fused_weight(4096, 1024) == 5120


def test_the_default_threshold_in_parts() -> None:
    assert q20(0.4) == 419430


def test_embeddings_are_rounded_to_127_steps() -> None:
    assert quantised(np.array([1.0, -1.0, 0.0, 0.5], np.float32)).tolist() == [127, -127, 0, 64]


def test_long_sums_are_shortened_to_twenty_bits() -> None:
    assert shortened(np.array([1 << 25, -(1 << 24), 3])).tolist() == [1 << 19, -(1 << 18), 0]
    assert shortened(np.array([5, -7])).tolist() == [5, -7]


def test_cosines_take_integers_of_any_size() -> None:
    assert cosine(10**30, 10**30, 10**30) == Q20
