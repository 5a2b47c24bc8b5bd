"""From votes to a finished map, by hand: what a voxel shows, what exists, and how sure it is. No vote is altered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from openvox.core.mapper_parameters import OPENVOX, PAPER, MapperParameters
from openvox.core.types import InstanceMap
from openvox.core.voxels import voxel_key
from openvox.mapper import smoothing
from openvox.mapper.codebook import Fragment
from openvox.mapper.finish import finished_map, unit
from openvox.mapper.frameset import FrameSet
from openvox.mapper.life import Life

Voxel = tuple[int, int, int]
Votes = Mapping[Voxel, Mapping[int, int]]
ALWAYS = {"min_frames": 0, "min_share": 0.0, "min_voxels": 0, "min_part": 0.0, "min_confidence": 0.0}
ALONE = {"smoothing": 0, "rounds": 0, "holes": 0.0}
"""Every voxel shows what its own votes say."""


def fragment(f: int, *, matched: int = 0b1, seen: int = 0b1, score: float = 1.0) -> Fragment:
    """A fragment matched and seen in the frames whose bits are set, with detections of one score."""
    part = Fragment(f, 0, 0, np.zeros(0, np.int64), matched=FrameSet({0: matched}), seen=FrameSet({0: seen}))
    part.score, part.observations = round(score * 4096), 1
    return part


def finished(
    votes: Votes,
    instance_of: Mapping[int, int],
    parameters: MapperParameters = PAPER,
    fragments: Mapping[int, Fragment] | None = None,
) -> InstanceMap:
    """The finished map of these votes; voxels are handed over in the order given."""
    keys = voxel_key(np.array(list(votes), np.int64).reshape(-1, 3))
    rows = [(i, f, n) for i, counts in enumerate(votes.values()) for f, n in counts.items()]
    row, what, count = np.array(rows, np.int32).reshape(-1, 3).T
    known = fragments or {f: fragment(f) for f in instance_of}
    return finished_map((keys, row, what, count), known, instance_of, Life(parameters.finish), 0, parameters)


def openvox(**finish: Any) -> MapperParameters:
    """Preset openvox where everything exists and counts are not smoothed, but for what is given."""
    return replace(OPENVOX, finish=replace(OPENVOX.finish, **{**ALWAYS, **ALONE, **finish}))


def shown(result: InstanceMap) -> dict[Voxel, int]:
    """Instance by voxel."""
    return {
        (x, y, z): i for (x, y, z), i in zip(result.voxel_index.tolist(), result.voxel_instance.tolist(), strict=True)
    }


def line(*counts: Mapping[int, int]) -> Votes:
    """Votes of voxels beside each other along x."""
    return {(x, 0, 0): votes for x, votes in enumerate(counts)}


# ---- what a voxel shows ---------------------------------------------------------------------------------------------


def test_rows_ascend_and_every_vote_stays() -> None:
    result = finished({(1, 0, 0): {2: 3, 1: 1}, (-1, 5, 0): {2: 2}}, {1: 1, 2: 2})
    assert result.voxel_index.tolist() == [[-1, 5, 0], [1, 0, 0]]
    assert result.vote_offset.tolist() == [0, 1, 3]
    assert list(zip(result.vote_fragment.tolist(), result.vote_count.tolist(), strict=True)) == [(2, 2), (1, 1), (2, 3)]


def test_a_voxel_whose_votes_were_all_halved_away_has_no_row() -> None:
    result = finished({(0, 0, 0): {0: 0}, (1, 0, 0): {1: 1}}, {1: 1})
    assert result.voxel_index.tolist() == [[1, 0, 0]]


def test_a_map_without_votes_is_empty() -> None:
    result = finished({}, {}, OPENVOX)
    assert result.vote_offset.tolist() == [0]
    assert result.feature.shape == (0, 0)


@pytest.mark.parametrize(
    ("counts", "expected"),
    [({1: 2, 2: 3}, 2), ({1: 2, 2: 2}, 1), ({0: 2, 1: 2}, 0), ({0: 1, 1: 2}, 1), ({0: 3, 1: 2, 2: 2}, 0)],
)
def test_a_voxel_shows_the_strongest_instance_that_beats_background(counts: dict[int, int], expected: int) -> None:
    assert shown(finished({(0, 0, 0): counts}, {1: 1, 2: 2}))[0, 0, 0] == expected


def test_the_fragments_of_an_instance_vote_as_one() -> None:
    assert shown(finished({(0, 0, 0): {1: 3, 2: 2, 3: 2}}, {1: 1, 2: 2, 3: 2}))[0, 0, 0] == 2


def test_the_votes_of_a_shown_instance_over_all_votes_are_the_confidence_of_a_voxel() -> None:
    result = finished(line({0: 1, 1: 2, 2: 1}, {0: 3, 1: 1}), {1: 1, 2: 2})
    assert result.voxel_confidence.tolist() == [0.5, 0.75]  # 2 / 4, and background's 3 / 4


# ---- kernel counting ------------------------------------------------------------------------------------------------


def test_face_neighbours_count_once_where_own_votes_count_three_times() -> None:
    # middle: background 3 x 1 = 3 against 1's neighbours 2 + 2 = 4; with weight 5 it is 5 against 4
    votes = line({1: 2}, {0: 1}, {1: 2})
    assert shown(finished(votes, {1: 1}, openvox(smoothing=3)))[1, 0, 0] == 1
    assert shown(finished(votes, {1: 1}, openvox(smoothing=5)))[1, 0, 0] == 0
    assert shown(finished(votes, {1: 1}, openvox(smoothing=0)))[1, 0, 0] == 0


def test_neighbours_along_an_edge_do_not_count_and_no_row_is_made() -> None:
    votes: Votes = {(0, 0, 0): {1: 9}, (1, 1, 0): {0: 1}}
    assert shown(finished(votes, {1: 1}, openvox(smoothing=1))) == {(0, 0, 0): 1, (1, 1, 0): 0}


# ---- rounds at the borders of things and background ------------------------------------------------------------------


def test_a_round_hears_all_votes_of_a_neighbour_for_what_it_shows() -> None:
    # middle: 3 x 10 + 15 + 15 for background against 30 + 30; then 3 x 10 against 30 + 30, of 45 votes of either side
    votes = line({0: 15, 1: 30}, {0: 10}, {0: 15, 1: 30})
    assert shown(finished(votes, {1: 1}, openvox(smoothing=3)))[1, 0, 0] == 0
    assert shown(finished(votes, {1: 1}, openvox(smoothing=3, rounds=1)))[1, 0, 0] == 1


def test_one_neighbour_however_sure_does_not_outweigh_a_voxel() -> None:
    votes = {**line({1: 300}, {0: 10}), (1, 1, 0): {0: 1}}  # 300 against 31; then only 3 x 10 of them are heard
    assert shown(finished(votes, {1: 1}, openvox(smoothing=3)))[1, 0, 0] == 1
    assert shown(finished(votes, {1: 1}, openvox(smoothing=3, rounds=1)))[1, 0, 0] == 0


def test_between_two_things_a_voxel_s_own_votes_decide() -> None:
    votes = {**line({0: 4, 1: 5}, {2: 4}, {0: 4, 1: 5}), (1, 1, 0): {0: 1}}  # 9 + 9 for thing 1 are not heard
    assert shown(finished(votes, {1: 1, 2: 2}, openvox(smoothing=3, rounds=1)))[1, 0, 0] == 2


def test_away_from_the_border_nothing_is_decided_again() -> None:
    votes = line({1: 8}, {1: 1, 2: 2}, {1: 8})  # no voxel here shows background
    assert shown(finished(votes, {1: 1, 2: 2}, openvox(smoothing=3, rounds=1))) == {(x, 0, 0): 1 for x in range(3)}


def test_a_second_round_hears_the_first() -> None:
    votes = {**line({0: 15, 1: 30}, {0: 10}, {0: 10}), (1, 1, 0): {0: 15, 1: 30}, (2, 1, 0): {0: 15, 1: 30}}
    results = [shown(finished(votes, {1: 1}, openvox(smoothing=3, rounds=n))) for n in range(3)]
    # the last voxel has 30 + 10 against 30, then 30 against 10 + 30
    assert [[result[x, 0, 0] for x in (1, 2)] for result in results] == [[0, 0], [1, 0], [1, 1]]


# ---- holes -----------------------------------------------------------------------------------------------------------


def plane(**others: Mapping[int, int]) -> Votes:
    """5 x 5 voxels of thing 1; others: votes of x<column>y<row>."""
    votes = {(x, y, 0): {1: 2} for x in range(5) for y in range(5)}
    return {**votes, **{(int(name[1]), int(name[3]), 0): counts for name, counts in others.items()}}


@pytest.mark.parametrize(("most", "expected"), [(0.05, 1), (0.041, 0), (0.0, 0)])  # one voxel in 24 is .0417
def test_a_small_hole_in_a_thing_is_of_the_thing(most: float, expected: int) -> None:
    result = finished(plane(x2y2={0: 5}), {1: 1}, openvox(holes=most))
    assert shown(result)[2, 2, 0] == expected
    assert result.vote_fragment.tolist().count(0) == 1  # no vote is altered
    assert result.voxel_confidence[12] == (0 if expected else 1)


def test_a_patch_beside_two_things_is_no_hole() -> None:
    votes = plane(x2y2={0: 5}, x2y3={2: 5})
    assert shown(finished(votes, {1: 1, 2: 2}, openvox(holes=1.0)))[2, 2, 0] == 0


def test_a_patch_is_as_large_as_all_its_voxels_that_share_faces() -> None:
    votes = plane(x1y1={0: 5}, x2y1={0: 5}, x3y2={0: 5})  # two voxels, and one beyond an edge of them
    result = shown(finished(votes, {1: 1}, openvox(holes=1.5 / 22)))
    assert (result[1, 1, 0], result[2, 1, 0], result[3, 2, 0]) == (0, 0, 1)


def test_where_a_dropped_object_lay_in_another_is_a_hole() -> None:
    votes = plane(x2y2={2: 5})
    assert shown(finished(votes, {1: 1, 2: 2}, openvox(min_voxels=2, holes=0.05)))[2, 2, 0] == 1


# ---- existence ------------------------------------------------------------------------------------------------------


def test_voxels_smoothed_a_few_at_a_time_show_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    votes = {(x, y, 0): {0: (x * y) % 3, 1 + (x + y) % 2: 1 + (5 * x + y) % 4} for x in range(5) for y in range(4)}
    whole = shown(finished(votes, {1: 1, 2: 2}, openvox(smoothing=3)))
    assert len(set(whole.values())) == 2
    for few in (1, 3, 19, 20):
        monkeypatch.setattr(smoothing, "CHUNK", few)
        assert shown(finished(votes, {1: 1, 2: 2}, openvox(smoothing=3))) == whole


@pytest.mark.parametrize(
    ("limits", "exists"),
    [
        ({"min_frames": 2}, True),
        ({"min_frames": 3}, False),
        ({"min_share": 0.5}, True),  # matched in 2 of 4 frames
        ({"min_share": 0.51}, False),
        ({"min_voxels": 3}, True),
        ({"min_voxels": 4}, False),
    ],
)
def test_an_object_must_be_matched_often_enough_and_be_large_enough(limits: dict[str, float], exists: bool) -> None:
    fragments = {1: fragment(1, matched=0b0011, seen=0b1110)}
    result = finished(line({1: 2}, {1: 2}, {1: 2}), {1: 1}, openvox(**limits), fragments)
    assert result.instance_id.tolist() == ([1] if exists else [])
    assert result.fragment_instance.tolist() == ([1] if exists else [0])
    assert result.vote_count.tolist() == [2, 2, 2]


@pytest.mark.parametrize(
    ("min_frames", "matched", "seen", "brief", "exists"),
    [
        (2, 0b001, 0b001, True, True),  # in view once, and matched then: a detector that looks seldom saw no more of it
        (2, 0b001, 0b001, False, False),
        (2, 0b001, 0b011, True, False),  # in view twice, matched once
        (3, 0b011, 0b011, True, True),
        (3, 0b011, 0b111, True, False),
    ],
)
def test_what_few_frames_saw_must_be_matched_in_all_of_them(
    min_frames: int, matched: int, seen: int, brief: bool, exists: bool
) -> None:
    fragments = {1: fragment(1, matched=matched, seen=seen)}
    result = finished(line({1: 2}), {1: 1}, openvox(min_frames=min_frames, brief=brief), fragments)
    assert result.instance_id.tolist() == ([1] if exists else [])


def test_what_is_dropped_says_why() -> None:
    result = finished(line({1: 2}), {1: 1}, openvox(min_voxels=4))
    assert [(event.kind, event.instance) for event in result.events] == [("dropped", 1)]
    assert "1 voxels" in result.events[0].text


def test_loose_parts_below_the_share_are_dropped_and_corners_connect() -> None:
    body = {(x, 0, 0): {1: 2} for x in range(8)}
    corner = {(8, 1, 1): {1: 2}}  # touches the body by a corner
    loose = {(20, 0, 0): {1: 2}}  # 1 of 10 voxels
    votes: Votes = {**body, **corner, **loose}
    result = shown(finished(votes, {1: 1}, openvox(min_part=0.11)))
    assert result[8, 1, 1] == 1
    assert result[20, 0, 0] == 0
    assert shown(finished(votes, {1: 1}, openvox(min_part=0.1)))[20, 0, 0] == 1


def test_a_long_part_is_one_part_however_it_winds() -> None:
    snake: dict[Voxel, Mapping[int, int]] = {(x, 4 * row, 0): {1: 2} for row in range(6) for x in range(12)}
    for row in range(5):  # joined at alternate ends
        snake.update({(11 * (1 - row % 2), 4 * row + step, 0): {1: 2} for step in (1, 2, 3)})
    result = finished(snake, {1: 1}, openvox(min_part=1.0))
    assert (result.voxel_instance == 1).all()


def test_parts_of_other_instances_in_between_do_not_connect() -> None:
    result = shown(finished(line({1: 2}, {1: 2}, {2: 2}, {1: 2}), {1: 1, 2: 2}, openvox(min_part=0.5)))
    assert [result[x, 0, 0] for x in range(4)] == [1, 1, 2, 0]


# ---- confidence -----------------------------------------------------------------------------------------------------


def test_confidence_in_paper_is_the_mean_share() -> None:
    result = finished(line({1: 2}, {1: 1, 2: 1}), {1: 1, 2: 2})
    assert result.instance_confidence.tolist() == [0.75]  # shares 1 and 1/2


def test_a_thing_whose_outline_nobody_disputes_is_all_right() -> None:
    # share 1, matched in k = 2 of v = 4 frames: x 2/4; all its faces lead to itself or to sure background
    fragments = {1: fragment(1, matched=0b0011, seen=0b1110, score=0.5)}
    result = finished(line({0: 4}, {1: 2}, {1: 2}, {0: 4}), {1: 1}, openvox(), fragments)
    assert result.instance_confidence.tolist() == [0.5]


def test_doubt_on_both_sides_of_the_outline_counts() -> None:
    # three voxels, votes 8, 8 and 6 of 8, and 2 elsewhere: 22/(24 + 2); 5 faces to voxels of the map: four inside, one
    # to background, where 1/4 of the votes on either side disagree: d = 1/2, (5 - d)/(5 + d) = 9/11
    result = finished(line({1: 8}, {1: 8}, {1: 6, 0: 2}, {0: 6, 1: 2}), {1: 1}, openvox(), {1: fragment(1, matched=3)})
    assert result.instance_confidence[0] == pytest.approx(22 / 26 * 9 / 11 * 2 / 4, abs=1e-5)


def test_a_small_thing_in_doubt_hopes_for_less_than_a_large_one() -> None:
    sure, doubt = {1: 8}, {1: 6, 0: 2}
    small, large = (
        finished(line({0: 6, 1: 2}, doubt, *[sure] * n, doubt, {0: 6, 1: 2}), {1: 1}, openvox()).instance_confidence[0]
        for n in (1, 9)
    )
    assert small < large


def test_a_voxel_alone_in_the_map_says_nothing() -> None:
    assert finished(line({1: 2}), {1: 1}, openvox()).instance_confidence.tolist() == [0.0]


def test_a_score_counts_against_those_of_all_masks() -> None:
    # scores 0.5 and 1.0, mean 0.75: the lower counts 2/3, squared where existence is the order; the other never over 1
    fragments = {1: fragment(1, matched=3, seen=3, score=0.5), 2: fragment(2, matched=3, seen=3, score=1.0)}
    votes = line({1: 2}, {1: 2}, {0: 2}, {2: 2}, {2: 2})
    for ranking, expected in (("overlap", 2 / 3), ("existence", 4 / 9)):
        result = finished(votes, {1: 1, 2: 2}, openvox(ranking=ranking), fragments)
        low, high = result.instance_confidence.tolist()
        assert high == pytest.approx(0.5, abs=1e-5)
        assert low == pytest.approx(0.5 * expected, abs=1e-5)


def test_frames_that_matched_several_fragments_of_an_instance_count_once() -> None:
    # matched in frames 0, 1 and 2 together, never seen beside: 3/5
    fragments = {1: fragment(1, matched=0b011, seen=0), 2: fragment(2, matched=0b110, seen=0)}
    result = finished(line({1: 2}, {2: 2}), {1: 1, 2: 1}, openvox(), fragments)
    assert result.instance_confidence[0] == pytest.approx(0.6, abs=1e-5)
    assert result.instances[0].observations == 3


@pytest.mark.parametrize(("floor", "exists"), [(0.1875, True), (0.188, False)])
def test_objects_whose_existence_is_below_the_floor_are_dropped(floor: float, exists: bool) -> None:
    # 3/4 of the votes, matched in k = 2 of v = 8 frames: 3/4 x 2/4 x the root of 2/8
    fragments = {1: fragment(1, matched=0b11, seen=0b11111111)}
    result = finished(line({1: 6, 0: 2}, {1: 6, 0: 2}), {1: 1}, openvox(min_confidence=floor), fragments)
    assert result.voxel_instance.tolist() == ([1, 1] if exists else [0, 0])


# ---- features -------------------------------------------------------------------------------------------------------


def test_a_codebook_sum_leaves_at_unit_length_and_null_stays_null() -> None:
    assert unit(np.array([3 << 30, -(4 << 30)])).tolist() == [np.float32(0.6), np.float32(-0.8)]
    assert unit(np.zeros(3, np.int64)).tolist() == [0.0, 0.0, 0.0]
