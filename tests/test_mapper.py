"""What the mapper promises, on walls and rectangles and on any small world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from strategies import World, rectangle, small, wall, worlds

from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.fixedpoint import Q20
from openvox.core.mapper_parameters import OPENVOX, PAPER, MapperParameters
from openvox.core.parameters import updated
from openvox.core.types import Frame, InstanceMap, Intrinsics, Mask, Pose, Rig, Step
from openvox.mapper.engines.engine import vote_worth
from openvox.mapper.mapper import Mapper

LIKELY = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large]
)


def mapped(
    frames: Sequence[tuple[Frame, Sequence[Mask] | None]], parameters: MapperParameters
) -> tuple[list[Step], InstanceMap]:
    mapper = Mapper(parameters)
    steps = [mapper.step(frame, masks) for frame, masks in frames]
    return steps, mapper.finish()


# ---- any small world ------------------------------------------------------------------------------------------------


@LIKELY
@given(world=worlds())
def test_counts_are_positive_and_a_voxel_is_as_sure_as_the_share_of_what_it_shows(world: World) -> None:
    _, result = mapped(world.frames, world.parameters)
    assert (result.vote_count > 0).all()
    assert (np.diff(result.vote_offset) > 0).all()
    assert ((result.voxel_confidence >= 0) & (result.voxel_confidence <= 1)).all()
    for voxel, shown in enumerate(result.voxel_instance.tolist()):
        of = {0: 0, **dict(zip(result.fragment_id.tolist(), result.fragment_instance.tolist(), strict=True))}
        row = slice(result.vote_offset[voxel], result.vote_offset[voxel + 1])
        shares: dict[int, float] = {}
        for fragment, count in zip(result.vote_fragment[row].tolist(), result.vote_count[row].tolist(), strict=True):
            key = of.get(fragment, -1) or (-1 if fragment else 0)  # -1: nameless, or of instances that were dropped
            if fragment or not world.parameters.evolution.veto:
                shares[key] = shares.get(key, 0.0) + count
        shares = {key: count / sum(shares.values()) for key, count in shares.items()}
        assert result.voxel_confidence[voxel] == pytest.approx(shares.get(shown, 0.0), abs=1e-5)


@LIKELY
@given(world=worlds())
def test_the_changes_of_all_steps_rebuild_the_votes(world: World) -> None:
    steps, result = mapped(world.frames, world.parameters)
    index: list[tuple[int, ...]] = []
    counts: dict[tuple[int, int], int] = {}
    for step in steps:
        assert step.changes.first_new == len(index)
        index += map(tuple, step.changes.new_index.tolist())
        for voxel, fragment, count in zip(
            step.changes.voxel.tolist(), step.changes.fragment.tolist(), step.changes.count.tolist(), strict=True
        ):
            counts[voxel, fragment] = count
    rebuilt = {(index[voxel], fragment): count for (voxel, fragment), count in counts.items() if count}
    rows = np.repeat(np.arange(len(result.voxel_index)), np.diff(result.vote_offset))
    expected = {
        (tuple(result.voxel_index[row].tolist()), int(fragment)): int(count)
        for row, fragment, count in zip(rows, result.vote_fragment, result.vote_count, strict=True)
    }
    assert rebuilt == expected


@LIKELY
@given(world=worlds())
def test_sizes_kept_frame_by_frame_equal_sizes_counted_anew(world: World) -> None:
    mapper = Mapper(world.parameters)
    owner: dict[int, int] = {}
    for frame, masks in world.frames:
        step = mapper.step(frame, masks)
        owner.update(zip(step.changes.touched.tolist(), step.changes.owner.tolist(), strict=True))
        for f, fragment in mapper._fragments.items():
            assert fragment.voxels == sum(other == f for other in owner.values())


@LIKELY
@given(world=worlds())
def test_what_was_not_looked_at_changes_nothing(world: World) -> None:
    seen = [(frame, masks) for frame, masks in world.frames if masks is not None]
    steps, result = mapped(world.frames, world.parameters)
    assert map_digest(result) == map_digest(mapped(seen, world.parameters)[1])
    assert all(not step.decisions and not len(step.changes.voxel) for step in steps if not step.looked)


@LIKELY
@given(world=worlds())
def test_the_order_of_masks_of_unlike_areas_changes_their_numbers_alone(world: World) -> None:
    chosen = world.parameters
    frames = [(f, m) for f, m in world.frames if m is None or len({mask.area for mask in m}) == len(m)]
    turned = [(frame, None if masks is None else masks[::-1]) for frame, masks in frames]
    assert map_digest(mapped(frames, chosen)[1]) == map_digest(mapped(turned, chosen)[1])


@LIKELY
@given(world=worlds())
def test_openvox_without_its_rules_is_paper(world: World) -> None:
    switches = ("masks.one_vote", "association.containment", "evolution.background", "finish.existence")
    off = updated(
        OPENVOX,
        {
            **dict.fromkeys(switches, False),
            "masks.min_pixels": 0,
            "evolution.near": 0.0,
            "finish.smoothing": 0,
            "finish.rounds": 0,
            "finish.holes": 0.0,
        },
        source="test",
    )
    size = world.parameters.map
    a, b = (mapped(world.frames, replace(each, map=size)) for each in (off, PAPER))
    assert [step.decisions for step in a[0]] == [step.decisions for step in b[0]]
    assert map_digest(a[1]) == map_digest(b[1])


# ---- single rules ---------------------------------------------------------------------------------------------------


def test_a_first_mask_founds_an_instance_and_the_next_one_finds_it() -> None:
    mask = rectangle(2, 2, 9, 8, embedding=np.array([1.0, 0.0], np.float32), caption="a box")
    steps, result = mapped([(wall(0), (mask,)), (wall(1), (mask,))], small(PAPER))
    first, second = (step.decisions[0] for step in steps)
    assert (first.by, first.instance, first.candidates) == ("new", 1, ())
    assert (second.by, second.instance) == ("threshold", 1)
    assert second.s_geo == second.s_fea == second.a == second.visibility == Q20
    assert second.credibility == 4096
    assert result.instances[0].caption == "a box"
    assert result.instances[0].observations == 2


def test_a_mask_that_is_mostly_new_ground_founds_an_instance_in_paper_and_joins_by_containment_in_openvox() -> None:
    small_one, large_one = rectangle(1, 2, 4, 8), rectangle(1, 2, 11, 8)
    frames = [(wall(0), (small_one,)), (wall(1), (large_one,))]
    assert [step.decisions[0].by for step in mapped(frames, small(PAPER))[0]] == ["new", "new"]
    chosen = small(OPENVOX, erosion=0)
    assert [step.decisions[0].by for step in mapped(frames, chosen)[0]] == ["new", "containment"]


def test_looked_and_nothing_found_votes_for_background() -> None:
    steps, result = mapped([(wall(0), ())], small(OPENVOX))
    assert steps[0].looked
    assert (result.vote_fragment == 0).all()
    assert (result.vote_count == 4).all()  # half a vote, and at 1 m one counts four times


def test_a_vote_counts_more_from_near() -> None:
    square = np.array(
        [0, 50**2, 50**2 + 1, 75**2, 75**2 + 1, 150**2]
    )  # 6 m / k: 1.5, 2 and 3 m are 37.5, 50 and 75 voxels
    assert vote_worth(square, 0.04, 6.0).tolist() == [4, 3, 2, 2, 1, 1]
    assert vote_worth(square, 0.04, 0.0).tolist() == [1] * 6


def test_a_missed_object_is_not_voted_away_but_a_voxel_left_out_is() -> None:
    whole, part = rectangle(2, 2, 10, 8), rectangle(2, 2, 8, 8)
    chosen = small(OPENVOX, erosion=0)
    missed, _ = mapped([(wall(0), (whole,)), *((wall(i), ()) for i in range(1, 4))], chosen)
    assert all(not len(step.changes.touched) or not (step.changes.owner == 1).any() for step in missed[1:])
    _, result = mapped([(wall(0), (whole,)), *((wall(i), (part,)) for i in range(1, 4))], chosen)
    shown = result.voxel_index[result.voxel_instance == 1]
    assert shown[:, 0].max() < 3  # columns 8 and 9 see x >= 0.25 m


def test_small_and_empty_masks_are_told_apart() -> None:
    depth = np.full((10, 12), 1000, np.uint16)
    depth[:, :4] = 0
    masks = (rectangle(0, 0, 1, 1), rectangle(0, 0, 4, 10), rectangle(0, 0, 0, 0))
    steps, _ = mapped([(wall(0, depth), masks)], small(OPENVOX, min_pixels=2, erosion=0))
    assert [decision.by for decision in steps[0].decisions] == ["small", "empty", "small"]
    assert [decision.instance for decision in steps[0].decisions] == [0, 0, 0]


@pytest.mark.parametrize("depth", [0, 65535])
def test_frames_without_usable_depth_leave_an_empty_map(depth: int) -> None:
    steps, result = mapped([(wall(0, depth), (rectangle(2, 2, 9, 8),))], small(OPENVOX))
    assert steps[0].voxels == 0
    assert len(result.voxel_index) == 0


def test_votes_halve_above_the_limit() -> None:
    mask = rectangle(0, 0, 12, 10)
    chosen = updated(small(OPENVOX, erosion=0), {"evolution.halving": 3, "evolution.near": 0.0}, source="test")
    # 2 units a frame, and more than 6 are halved: 2 4 6 4 (8 / 2) 6 4
    counts = [mapped([(wall(i), (mask,)) for i in range(n)], chosen)[1].vote_count[0] for n in (1, 2, 3, 4, 5, 6)]
    assert counts == [2, 4, 6, 4, 6, 4]


def test_kilometres_from_the_origin_and_below_it_give_the_same_map_shifted() -> None:
    mask = rectangle(2, 2, 9, 8)
    here = mapped([(wall(0), (mask,))], small(PAPER))[1]
    there = mapped([(wall(0, pose=Pose((0.0, 0.0, 0.0, 1.0), (-20_000.0, 30_000.0, -1.0))), (mask,))], small(PAPER))[1]
    assert (there.voxel_index - here.voxel_index == [-200_000, 300_000, -10]).all()


def test_a_mask_outside_the_picture_and_mixed_embeddings_are_one_sentence() -> None:
    big = Intrinsics(40, 40, 10.0, 10.0, 5.5, 4.5)
    with pytest.raises(InputError, match=r"frame 0, mask 0: its box .* leaves the colour image of 12x10"):
        mapped([(wall(0), (rectangle(0, 0, 30, 30, big),))], small(PAPER))
    plain = rectangle(2, 2, 9, 8)
    vector = replace(plain, embedding=np.array([1.0, 0.0], np.float32))
    with pytest.raises(InputError, match="frame 1, mask 0: its embedding has 2 numbers, earlier ones 0"):
        mapped([(wall(0), (plain,)), (wall(1), (vector,))], small(PAPER))


def test_a_cut_moves_votes_and_loses_none() -> None:
    whole, left, right = rectangle(0, 0, 12, 10), rectangle(0, 0, 5, 10), rectangle(5, 0, 12, 10)
    frames = [(wall(0), (whole,)), (wall(1), (left, right))]
    chosen = small(OPENVOX, erosion=0)
    steps, cut = mapped(frames, chosen)
    assert [(decision.by, decision.fragment) for decision in steps[1].decisions] == [("cut", 2), ("containment", 1)]
    _, uncut = mapped(frames, updated(chosen, {"evolution.cut": False}, source="test"))
    assert cut.voxel_index.tolist() == uncut.voxel_index.tolist()
    totals = [np.add.reduceat(each.vote_count, each.vote_offset[:-1]).tolist() for each in (cut, uncut)]
    assert totals[0] == totals[1]
    assert set(cut.vote_count.tolist()) == {16}  # both frames' votes of a voxel, 2 x 4 each at 1 m, lie with one piece
    assert set(cut.vote_fragment.tolist()) == {1, 2}


# ---- welds ----------------------------------------------------------------------------------------------------------

WIDE = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
LEFT, RIGHT, BOTH = (rectangle(*corners, WIDE) for corners in ((8, 8, 32, 40), (32, 8, 56, 40), (8, 8, 56, 40)))


def welded(preset: MapperParameters, masks: Sequence[tuple[Mask, ...]]) -> list[float]:
    """IoU of the left and of the right half of a wall with their best instances."""
    _, result = mapped([(wall(i, rig=Rig(WIDE, WIDE)), found) for i, found in enumerate(masks)], preset)
    x, y = (result.voxel_index[:, axis] * 0.04 + 0.02 for axis in (0, 1))
    inside = (abs(x) < 0.4) & (y > -0.26) & (y < 0.27)
    shown = result.voxel_instance
    ious = []
    for half in (inside & (x < 0), inside & (x > 0)):
        best = [((shown == i) & half).sum() / ((shown == i) | half).sum() for i in result.instance_id.tolist()]
        ious.append(float(max(best, default=0.0)))
    return ious


WELD = [(BOTH,)] * 10
APART = [(LEFT, RIGHT)]


def test_two_boxes_welded_by_ten_masks_come_apart_within_twelve_frames_and_in_paper_never() -> None:
    # without captions: the pieces inherit T = 1.1 x 20 half votes, whatever they count from here; a frame adds 2 to S
    assert min(welded(OPENVOX, WELD + APART * 10)) < 0.8
    assert min(welded(OPENVOX, WELD + APART * 12)) > 0.8
    assert min(welded(PAPER, WELD + APART * 30)) < 0.8


def test_a_thing_seen_as_two_for_nine_frames_stays_one() -> None:
    # T is at least 20, and each frame of two masks adds 2 to S: the tenth tips it
    steps, _ = mapped(
        [(wall(i, rig=Rig(WIDE, WIDE)), found) for i, found in enumerate([(BOTH,)] * 3 + APART * 12)], OPENVOX
    )
    assert [len(set(step.instance_of.values())) for step in steps] == [1] * 12 + [2] * 3


def test_a_cut_piece_does_not_remember_what_was_said_of_the_whole() -> None:
    bed, cat = np.array([1.0, 0.0], np.float32), np.array([0.0, 1.0], np.float32)
    whole, left = replace(BOTH, caption="a bed", embedding=bed), replace(LEFT, caption="a bed", embedding=bed)
    right = replace(RIGHT, caption="a cat", embedding=cat)
    # captions without anything in common make T worth nothing: the second frame already tells two things
    frames = [(wall(i, rig=Rig(WIDE, WIDE)), found) for i, found in enumerate([(whole,)] * 10 + [(left, right)])]
    result = mapped(frames, OPENVOX)[1]
    assert [summary.caption for summary in result.instances] == ["a bed", "a cat"]


def test_a_camera_that_stood_still_before_a_weld_still_learns_better() -> None:
    # without halving T = 20 + 2 x 130 against S = 2 x 60; with it T goes 20 .. 200, 100 .. 180, and halves once more
    masks = [(BOTH,)] * 3 + APART + [(BOTH,)] * 130 + APART * 60
    frames = [(wall(i, rig=Rig(WIDE, WIDE)), found) for i, found in enumerate(masks)]
    instances = [
        [
            len(set(step.instance_of.values()))
            for step in mapped(frames, updated(OPENVOX, {"lifecycle.halving": n}, source="test"))[0]
        ]
        for n in (200, 0)
    ]
    assert [each[-1] for each in instances] == [2, 1]


def test_one_more_mask_over_both_boxes_does_not_weld_them_again() -> None:
    frames = [(wall(i, rig=Rig(WIDE, WIDE)), found) for i, found in enumerate(WELD + APART * 12 + [(BOTH,)])]
    before, after = (mapped(frames[:n], OPENVOX)[1].voxel_instance for n in (22, 23))
    assert len(np.unique(before[before > 0])) == 2
    assert (before != after).mean() < 0.01


def test_a_mask_that_leaves_a_piece_in_view_out_says_that_it_is_another_thing() -> None:
    # LEFT founds 1; BOTH holds it and RIGHT's ground; RIGHT cuts that off as 2; then RIGHT is missed, LEFT is not
    masks = [(BOTH,), (LEFT, RIGHT), *[(LEFT,)] * 3]
    frames = [(wall(i, rig=Rig(WIDE, WIDE)), found) for i, found in enumerate(masks)]
    pieces = {"evolution.cut_inheritance": 3.0, "evolution.cut_least": 0}
    chosen = updated(OPENVOX, pieces, source="test")  # T = 3 x 2, S = 2 + 2 a frame
    assert [len(set(step.instance_of.values())) for step in mapped(frames, chosen)[0]] == [1, 1, 1, 2, 2]
    silent = updated(chosen, {"lifecycle.omission": 0}, source="test")
    assert [len(set(step.instance_of.values())) for step in mapped(frames, silent)[0]] == [1, 1, 1, 1, 1]


def test_one_box_seen_as_two_for_ten_frames_is_one_at_the_end() -> None:
    masks = [(LEFT, RIGHT)] * 10 + [(BOTH,)] * 30
    _, result = mapped([(wall(i, rig=Rig(WIDE, WIDE)), found) for i, found in enumerate(masks)], OPENVOX)
    assert len(result.instance_id) == 1
