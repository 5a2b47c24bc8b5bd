"""Which fragments are one thing: counts for and against, and the clusters that follow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from openvox.core.mapper_parameters import LifecycleParameters
from openvox.core.types import Mask, MaskKind
from openvox.mapper.associate import Association
from openvox.mapper.codebook import Fragment
from openvox.mapper.cut import Nesting, count_pairs
from openvox.mapper.evidence import Evidence, cluster, pair
from openvox.mapper.state import evidence_arrays, restore_evidence

NODES = range(1, 7)
PAIRS = st.tuples(st.sampled_from(NODES), st.sampled_from(NODES)).filter(lambda fg: fg[0] != fg[1])


def fragment(f: int, *feature: int) -> Fragment:
    part = Fragment(f, 0, 0, np.zeros(len(feature), np.int64))
    part.observe(1, np.array(feature, np.int64), ())
    return part


def test_the_heaviest_pair_joins_first_and_contradictions_add_up() -> None:
    # 1-2 join; then {1, 2}-3 weighs 4 - 5 = -1
    assert cluster([1, 2, 3], {(1, 2): 6, (2, 3): 4, (1, 3): -5}) == {1: 1, 2: 1, 3: 3}


def test_without_a_contradiction_a_chain_is_one_thing() -> None:
    assert cluster([1, 2, 3], {(1, 2): 6, (2, 3): 4}) == {1: 1, 2: 1, 3: 1}


def test_ties_go_to_the_lowest_pair() -> None:
    # 1-2 and 2-3 weigh the same: 1-2 joins, and then 3 is kept out
    assert cluster([1, 2, 3], {(1, 2): 5, (2, 3): 5, (1, 3): -6}) == {1: 1, 2: 1, 3: 3}


def test_fragments_seen_apart_as_often_as_together_are_kept_apart_and_unseen_ones_are_not() -> None:
    evidence = Evidence(LifecycleParameters())
    for f in (1, 2, 3):
        evidence.add_fragment(f)
    evidence.add_together(1, 2, 2)
    evidence.add_apart(1, 2, 2)
    assert evidence.kept_apart(2, 1)
    assert not evidence.kept_apart(1, 3)


def test_unlike_captions_weaken_togetherness() -> None:
    fragments = {1: fragment(1, 127, 0), 2: fragment(2, 0, 127), 3: fragment(3, 127, 0)}
    evidence = Evidence(LifecycleParameters())
    for f in fragments:
        evidence.add_fragment(f)
    evidence.add_together(1, 2, 2)
    evidence.add_together(1, 3, 2)
    evidence.update([1, 2, 3], fragments)
    assert evidence.instance_of == {1: 1, 2: 2, 3: 1}
    assert evidence.members == {1: (1, 3), 2: (2,)}


def test_what_was_joined_comes_apart_again() -> None:
    fragments = {f: fragment(f, 127) for f in (1, 2)}
    evidence = Evidence(LifecycleParameters())
    for f in fragments:
        evidence.add_fragment(f)
    evidence.add_together(1, 2, 2)
    evidence.update([1, 2], fragments)
    assert evidence.instance_of == {1: 1, 2: 1}
    evidence.add_apart(1, 2, 4)
    evidence.update([1, 2], fragments)
    assert evidence.instance_of == {1: 1, 2: 2}


@given(st.lists(st.lists(st.tuples(PAIRS, st.booleans(), st.integers(1, 6)), max_size=4), max_size=8))
def test_clusters_kept_frame_by_frame_equal_those_of_all_evidence(
    frames: list[list[tuple[tuple[int, int], bool, int]]],
) -> None:
    fragments = {f: fragment(f, 127) for f in NODES}
    evidence = Evidence(LifecycleParameters())
    for f in NODES:
        evidence.add_fragment(f)
    weights: dict[tuple[int, int], int] = {}
    for frame in frames:
        for (f, g), together, amount in frame:
            (evidence.add_together if together else evidence.add_apart)(f, g, amount)
            weights[pair(f, g)] = weights.get(pair(f, g), 0) + (16 if together else -16) * amount
        evidence.update(sorted({f for both, _, _ in frame for f in both}), fragments)
        assert evidence.instance_of == cluster(NODES, weights)
        assert sorted(f for group in evidence.members.values() for f in group) == list(NODES)


# Evidence by kind of mask


LIFECYCLE = LifecycleParameters()


def counted(
    kinds: list[MaskKind],
    held: list[set[int]],
    pixels: int = 2000,
    captions: tuple[str, ...] = ("", "", ""),
    parameters: LifecycleParameters = LIFECYCLE,
) -> Evidence:
    """Evidence after one frame: masks side by side of these kinds hold these fragments, each in `pixels` pixels."""
    evidence = Evidence(LifecycleParameters())
    fragments = sorted(set().union(*held))
    for f in fragments:
        evidence.add_fragment(f)
    masks, found, overlap = [], [], np.zeros((len(kinds) + 1, len(fragments)), np.int64)
    for m, (kind, group) in enumerate(zip(kinds, held, strict=True)):
        bitmap = np.zeros((10, 100_000), np.bool_)
        bitmap[m, : pixels * len(group)] = True
        masks.append(Mask.from_bitmap(bitmap, kind=kind, caption=captions[m]))
        found.append(Association(m, 10 * len(group), held=group))
        overlap[m, [fragments.index(f) for f in group]] = 10
    nesting = Nesting(masks, 0.7)
    count_pairs(masks, found, np.array(fragments, np.int32), overlap, nesting, evidence, parameters)
    return evidence


@pytest.mark.parametrize(
    ("kinds", "apart"),
    [
        (["object", "object"], 2),
        (["region", "region"], 1),  # nothing better in the frame
        (["region", "region", "object"], 0),
        (["support", "support"], 0),  # parts of one thing on a table, perhaps
        (["region", "support"], 4),
        (["object", "support"], 4),
        (["region", "object"], 2),
    ],
)
def test_masks_side_by_side_contradict_each_other_as_their_kinds_know(kinds: list[MaskKind], apart: int) -> None:
    evidence = counted(kinds, [{i + 1} for i in range(len(kinds))])
    assert evidence.apart.get((1, 2), 0) == apart


@pytest.mark.parametrize(
    ("captions", "apart"),
    [
        (("a red object", "a large green sofa"), 1),
        (("a red object on a green table", "a green sofa"), 1),  # of the table nothing is said
        (("a red and green object", "a green sofa"), 0),
        (("a red object", "a sofa"), 0),
    ],
)
@pytest.mark.parametrize("kind", ["region", "support"])
def test_of_pieces_of_one_thing_the_captions_share_a_colour(kind: MaskKind, captions: tuple[str, str], apart: int):
    evidence = counted([kind, kind, "object"], [{1}, {2}, {3}], captions=(*captions, ""))
    assert evidence.apart.get((1, 2), 0) == apart
    blind = LifecycleParameters(colors=False)
    without = counted([kind, kind, "object"], [{1}, {2}, {3}], captions=(*captions, ""), parameters=blind)
    assert (1, 2) not in without.apart


def test_what_stands_on_something_says_nothing_of_a_smaller_region_as_that_does_not_bear_it():
    kinds: list[MaskKind] = ["support", "region"]
    assert counted(kinds, [{1, 3}, {2}]).apart == {}
    assert counted(kinds, [{1}, {2}]).apart == {(1, 2): 4}
    assert counted(kinds, [{1}, {2, 3}]).apart == {(1, 2): 4, (1, 3): 4}


@pytest.mark.parametrize(
    ("kinds", "clear", "small"),
    [
        (["object"], 2, 2),  # no regions from depth: nothing is lost from afar
        (["region"], 2, 1),
        (["object", "region"], 6, 3),
    ],
)
def test_where_depth_made_the_masks_small_things_lie_in_them_for_less(
    kinds: list[MaskKind], clear: int, small: int
) -> None:
    held = [{1, 2}, {3}][: len(kinds)]
    assert counted(kinds, held, 1000).together == {(1, 2): clear}
    assert counted(kinds, held, 999).together == {(1, 2): small}


# Resumed


def test_counts_are_restored_as_they_were_even_above_the_limit() -> None:
    parameters = LifecycleParameters(halving=10)
    fragments = {f: fragment(f, 127) for f in (1, 2, 3)}
    before, after = Evidence(parameters), Evidence(parameters)
    for f in fragments:
        before.add_fragment(f)
    before.add_together(1, 2, 44)  # halved once, when it is counted: 22 is above the limit still
    before.add_apart(2, 3, 4)
    before.update(fragments, fragments)
    restore_evidence(after, evidence_arrays(before), fragments)
    assert after.together == before.together == {(1, 2): 22}
    assert after.apart == before.apart == {(2, 3): 4}
    assert after.instance_of == before.instance_of == {1: 1, 2: 1, 3: 3}
    assert after.neighbours(2) == before.neighbours(2) == [1]
