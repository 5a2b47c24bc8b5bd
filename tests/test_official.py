"""The choices of the authors' code, one by one, on walls of a few voxels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from strategies import CAMERA, rectangle, wall

from openvox.core.mapper_parameters import OFFICIAL, MapperParameters
from openvox.core.parameters import updated
from openvox.core.types import InstanceMap, Mask, Pose, Step
from openvox.mapper.engines.labels import disjoint
from openvox.mapper.engines.outliers import inliers
from openvox.mapper.mapper import Mapper

SMALL = {
    "masks.min_pixels": 0,
    "masks.window": 0,
    "masks.inliers": False,
    "map.voxel_size": 0.1,
    "finish.min_voxels": 1,
}


def official(**changes: Any) -> MapperParameters:
    """With limits that fit 12x10 pixels, and changes by name with __ for the dot."""
    named = {name.replace("__", "."): value for name, value in changes.items()}
    return updated(OFFICIAL, {**SMALL, **named}, source="test")


def mapped(
    parameters: MapperParameters, *frames: Sequence[Mask], pose: Pose | None = None
) -> tuple[list[Step], InstanceMap]:
    mapper = Mapper(parameters)
    steps = [mapper.step(wall(i, pose=pose), masks) for i, masks in enumerate(frames)]
    return steps, mapper.finish()


def test_masks_of_one_frame_see_the_votes_of_larger_ones() -> None:
    left, right = rectangle(0, 0, 6, 9), rectangle(6, 0, 10, 9)
    coarse = {"map__voxel_size": 1.0}
    aside = Pose((0.0, 0.0, 0.0, 1.0), (0.6, 0.6, 0.1))  # both lie in one voxel
    (step,), _ = mapped(official(**coarse), (right, left), pose=aside)
    assert [(decision.by, decision.instance) for decision in step.decisions] == [("threshold", 1), ("new", 1)]
    (step,), _ = mapped(official(**coarse, association__one_by_one=False), (right, left), pose=aside)
    assert [decision.by for decision in step.decisions] == ["new", "new"]


def test_a_voxel_keeps_its_first_three_ids_and_later_votes_are_nameless() -> None:
    mask = rectangle(0, 0, 12, 10)
    alone = official(association__threshold=1.0)  # nothing ever joins
    steps, result = mapped(alone, *[(mask,)] * 5)
    assert [step.decisions[0].instance for step in steps] == [1, 2, 3, 4, 5]
    assert result.vote_fragment[:4].tolist() == [-1, 1, 2, 3]
    assert result.vote_count[:4].tolist() == [2, 1, 1, 1]
    assert result.fragment_id.tolist() == [1, 2, 3]
    shares = [candidate.s_geo for candidate in steps[-1].decisions[0].candidates]
    assert shares == [2**20 // 4] * 3  # the nameless vote counts below


def test_a_voxel_with_three_votes_shows_nothing() -> None:
    mask = rectangle(0, 0, 12, 10)
    assert not mapped(official(), *[(mask,)] * 3)[1].voxel_instance.any()
    result = mapped(official(), *[(mask,)] * 4)[1]
    assert (result.voxel_instance == 1).all()
    assert result.instance_confidence.tolist() == [1.0]


def test_an_object_matched_in_two_frames_is_dropped() -> None:
    mask = rectangle(0, 0, 12, 10)
    assert not len(mapped(official(finish__min_votes=0), *[(mask,)] * 2)[1].instance_id)
    assert len(mapped(official(finish__min_votes=0), *[(mask,)] * 3)[1].instance_id) == 1


def test_ranking_by_matches_trusts_what_many_frames_matched() -> None:
    frames = [(rectangle(0, 0, 12, 10),)] * 4
    by_matches = mapped(official(finish__ranking="matches"), *frames)[1]
    assert by_matches.instance_confidence.tolist() == pytest.approx([4 / 6], abs=1e-5)


def test_the_veto_takes_what_was_seen_more_often_without_a_mask() -> None:
    whole, part = rectangle(0, 0, 12, 10), rectangle(0, 0, 6, 10)
    frames = [(whole,)] * 4 + [(part,)] * 5
    spilled, vetoed = (mapped(official(evolution__veto=veto), *frames)[1] for veto in (False, True))
    assert (spilled.voxel_instance == 1).all()
    x = vetoed.voxel_index[:, 0]
    assert (vetoed.voxel_instance[x < 0] == 1).all()  # columns 0 to 5 see x < 0
    assert not vetoed.voxel_instance[x > 0].any()
    assert vetoed.vote_count[vetoed.vote_fragment == 0].max() == 5


def test_a_pixel_stays_in_its_mask_if_its_whole_square_does() -> None:
    painted = disjoint([rectangle(0, 0, 12, 10), rectangle(8, 0, 12, 10)], CAMERA, window=2, least=1)
    rows, columns = np.nonzero(painted.image > 0)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (2, 7, 2, 5)
    assert painted.masks[1] is None  # four columns at the picture's border hold no square of five


def test_a_mask_with_too_few_whole_squares_is_small() -> None:
    (step,), _ = mapped(official(masks__window=2, masks__min_pixels=49), (rectangle(0, 0, 12, 10),))
    assert step.decisions[0].by == "small"  # 8 x 6 pixels are left
    (step,), _ = mapped(official(masks__window=2, masks__min_pixels=48), (rectangle(0, 0, 12, 10),))
    assert step.decisions[0].by == "new"


def test_a_voxel_far_from_the_others_of_its_mask_is_left_out() -> None:
    block = [(x, y, 0) for x in range(5) for y in range(5)]
    index = np.array([*block, (40, 0, 0)], np.int32)
    kept = inliers(index, np.arange(26, dtype=np.int32), np.zeros(26, np.int32), 1)
    assert kept.tolist() == [True] * 25 + [False]


def test_voxels_that_lie_alike_are_all_left_out_and_those_under_no_mask_stay() -> None:
    index = np.array([(0, 0, 0), (1, 0, 0), (9, 9, 9)], np.int32)
    kept = inliers(index, np.arange(3, dtype=np.int32), np.array([0, 0, 1], np.int32), 1)
    assert kept.tolist() == [False, False, True]  # as in the authors' code: no distance is below the mean of equals
