"""The measures on points: hand-made cases with hand-computed figures, and agreement with an independent scorer."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from maps import labelled_map
from numpy.typing import NDArray

from openvox.apps.scoring.instances import InstanceScore, Overlaps, average_precision, score_instances
from openvox.apps.scoring.labels import labels_of_rows, rows_at_points

TRUTH = np.repeat([0, 1, 2, 3], 1000)  # a thousand background points and three objects of a thousand
EQUAL: dict[int, float] = {}  # no confidence: ranked by points, then by id


@pytest.fixture(scope="session")
def oracle(shared_data: Path) -> ModuleType:
    """The scorer that stands beside the data."""
    path = shared_data.parent / "tools" / "score_points.py"
    if not path.is_file():
        pytest.skip(f"no scorer beside the data ({path})")
    spec = importlib.util.spec_from_file_location("score_points", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_perfect_labelling_scores_one_everywhere() -> None:
    s = score_instances(TRUTH, TRUTH * 7, EQUAL)
    assert (s.ap, s.ap50, s.ap25, s.f50, s.miou) == (1, 1, 1, 1, 1)
    assert (s.spill, s.missed_share, s.wrong_share) == (0, 0, 0)
    assert (s.predicted, s.true, s.split, s.merged, s.missed) == (3, 3, 0, 0, 0)
    assert [o.split_into for o in s.objects] == [(7,), (14,), (21,)]


def test_a_split_object_is_found_by_its_larger_piece_up_to_that_pieces_share() -> None:
    labels = TRUTH.copy()
    labels[1600:2000] = 9  # object 1: 600 points as 1, 400 as 9; IoU of the larger piece 0.6
    s = score_instances(TRUTH, labels, EQUAL)
    assert (s.split, s.merged, s.missed, s.predicted) == (1, 0, 0, 4)
    assert s.objects[0].split_into == (1, 9)
    assert s.objects[0].best_iou == 0.6
    assert s.miou == pytest.approx((0.6 + 1 + 1) / 3)
    assert s.wrong_share == pytest.approx(400 / 3000)
    assert s.f50 == pytest.approx(2 * 3 / (2 * 3 + 1))
    # ranked by size the pieces come last. Up to 0.55 all three are found before the one false alarm: AP 1.
    # From 0.60 on two are: steps 1/6 + 1/3 + 1/6 of recall at precision 1, false alarms at the end cost nothing.
    assert (s.ap50, s.ap25) == (1, 1)
    assert s.ap == pytest.approx((2 * 1 + 8 * 2 / 3) / 10)


def test_a_false_alarm_costs_when_it_is_ranked_first() -> None:
    labels = TRUTH.copy()
    labels[1600:2000] = 9
    s = score_instances(TRUTH, labels, {9: 0.9, 1: 0.5, 2: 0.5, 3: 0.5})
    # false, then 2, 3, 1 (by points): precision 0, 1/2, 2/3, 3/4 at recall 0, 1/3, 2/3, 1; steps of recall by halves:
    # 3/4 * 1/6 + 2/3 * 1/3 + 1/2 * 1/3 + 0 * 1/6 + 1 * 0
    assert s.ap50 == pytest.approx(3 / 4 / 6 + 2 / 9 + 1 / 6)


def test_two_objects_under_one_label_are_merged_and_one_of_them_is_missing() -> None:
    labels = np.where(TRUTH == 3, 2, TRUTH)
    s = score_instances(TRUTH, labels, EQUAL)
    assert (s.merged, s.split, s.missed, s.predicted) == (2, 0, 0, 2)
    assert [o.merged_with for o in s.objects] == [(), (3,), (2,)]
    assert [o.best_iou for o in s.objects] == [1.0, 0.5, 0.5]  # 0.5 is not above 0.5: no match there
    assert s.f50 == pytest.approx(2 * 1 / (2 * 1 + 1 + 2))
    # ranked by points the weld comes first. At 0.25 it finds one object, label 1 another, one is missing:
    # precision 1, 1 at recall 1/3, 2/3 -> 1/6 + 1/3 + 1/6. At 0.5 it is a false alarm: 0, 1/2 at recall 0, 1/3
    assert s.ap25 == pytest.approx(2 / 3)
    assert s.ap50 == pytest.approx(1 / 2 * 1 / 6 + 0 + 0)


def test_one_label_over_everything_spills_and_merges_all() -> None:
    s = score_instances(TRUTH, np.ones_like(TRUTH), EQUAL)
    assert (s.spill, s.missed_share, s.wrong_share) == (1, 0, 0)
    assert (s.ap, s.ap50, s.ap25, s.f50, s.miou) == (0, 0, 0, 0, 0.25)
    assert (s.merged, s.split, s.missed) == (3, 0, 0)


def test_background_under_an_object_costs_that_object() -> None:
    s = score_instances(TRUTH, np.where(TRUTH == 0, 1, TRUTH), EQUAL)
    assert s.spill == 1
    assert [o.best_iou for o in s.objects] == [0.5, 1, 1]


def test_no_label_at_all_misses_all() -> None:
    s = score_instances(TRUTH, np.zeros_like(TRUTH), EQUAL)
    assert (s.ap, s.f50, s.miou, s.spill, s.missed_share, s.wrong_share) == (0, 0, 0, 0, 1, 0)
    assert (s.predicted, s.true, s.missed, s.split, s.merged) == (0, 3, 3, 0, 0)
    assert [o.split_into for o in s.objects] == [(), (), ()]


def test_without_true_objects_what_cannot_be_measured_is_none() -> None:
    s = score_instances(np.zeros(50, np.int64), np.ones(50, np.int64), EQUAL)
    assert (s.ap, s.ap50, s.ap25, s.miou) == (None, None, None, None)
    assert (s.spill, s.predicted, s.true) == (1, 1, 0)


def test_an_object_of_too_few_points_is_neither_missed_nor_an_error_to_find() -> None:
    truth = np.repeat([0, 1, 2], [100, 14, 100])
    unseen = score_instances(truth, np.where(truth == 2, 2, 0), EQUAL)
    assert (unseen.ap, unseen.true, unseen.missed, unseen.missed_share) == (1, 1, 0, 0)
    assert unseen.objects[0].ignored
    grown = np.where(truth == 1, 1, truth)
    grown[99] = 1  # with one background point the prediction counts, but lies mostly on the ignored object
    seen = score_instances(truth, grown, {1: 1.0, 2: 0.5})
    assert (seen.predicted, seen.ap50, seen.f50) == (2, 1, 1)


def test_an_object_with_under_a_quarter_of_its_points_labelled_is_missed() -> None:
    truth = np.repeat([1, 2], 100)
    labels = np.concatenate([np.repeat([1, 0], [24, 76]), np.repeat([2, 0], [25, 75])])
    assert [o.missed for o in score_instances(truth, labels, EQUAL).objects] == [True, False]


@pytest.mark.parametrize(
    ("found", "missing", "expected"),
    [([], 0, None), ([], 2, 0.0), ([True], 0, 1.0), ([True, True, False, False], 1, 2 / 3), ([False, True], 0, 0.25)],
)
def test_average_precision_by_hand(found: list[bool], missing: int, expected: float | None) -> None:
    # [False, True]: precision 0, 1/2 at recall 0, 1: 1/2 * 1/2 + 0 * 1/2 + 1 * 0
    assert average_precision(found, missing) == (None if expected is None else pytest.approx(expected))


def test_overlaps_count_every_point_once() -> None:
    overlaps = Overlaps.count(np.array([0, 0, 4, 4, 9]), np.array([0, 7, 7, 2, 0]))
    assert (overlaps.true_ids.tolist(), overlaps.ids.tolist()) == ([4, 9], [2, 7])
    assert overlaps.table.tolist() == [[1, 0, 1], [0, 1, 1], [1, 0, 0]]


def test_a_point_takes_its_own_voxel_even_if_that_says_background_else_the_nearest_in_reach() -> None:
    result = labelled_map(np.array([[0, 0, 0], [1, 0, 0], [5, 5, 5]], np.int32), np.array([4, 0, 6], np.int32))
    points = np.array(
        [
            [0.02, 0.02, 0.02],  # in voxel 0: 4
            [0.06, 0.02, 0.02],  # in voxel 1, held as background
            [0.02, 0.06, 0.02],  # one edge from voxel 0, farther from voxel 1
            [0.02, 0.079, 0.02],  # 1.475 edges from voxel 0
            [0.02, 0.081, 0.02],  # 1.525 edges away: none
            [0.30, 0.30, 0.30],  # nothing near
            [1e5, 0.0, -1e5],  # outside of what a map can hold
        ]
    )
    rows = rows_at_points(points, result)
    assert rows.tolist() == [0, 1, 0, 0, -1, -1, -1]
    assert labels_of_rows(rows, result).tolist() == [4, 0, 4, 4, 0, 0, 0]
    assert rows_at_points(points, result, reach=0).tolist() == [0, 1, -1, -1, -1, -1, -1]


def test_between_two_equally_near_voxels_the_lower_row_speaks() -> None:
    result = labelled_map(np.array([[0, 0, 0], [2, 0, 0]], np.int32), np.array([8, 3], np.int32), voxel_size=1.0)
    assert rows_at_points(np.array([[1.5, 0.5, 0.5]]), result).tolist() == [0]


def test_an_empty_map_labels_nothing() -> None:
    result = labelled_map(np.zeros((0, 3), np.int32), np.zeros(0, np.int32))
    assert rows_at_points(np.zeros((2, 3)), result).tolist() == [-1, -1]


NAMES = {
    "AP": "ap",
    "AP50": "ap50",
    "AP25": "ap25",
    "f50": "f50",
    "miou": "miou",
    "spill": "spill",
    "missed": "missed_share",
    "wrong": "wrong_share",
    "n_pred": "predicted",
    "n_gt": "true",
    "n_split": "split",
    "n_merged": "merged",
    "n_missed": "missed",
}


def agrees(ours: InstanceScore, theirs: dict[str, Any]) -> None:
    """To the last digit."""
    for their_name, our_name in NAMES.items():
        value = theirs[their_name]
        assert getattr(ours, our_name) == (None if math.isnan(value) else value), our_name
    for o, other in zip(ours.objects, theirs["objects"], strict=True):
        found = (o.id, o.points, o.ignored, o.best_iou, [*o.split_into], [*o.merged_with], o.missed)
        assert found == tuple(
            other[k] for k in ("id", "points", "ignored", "best_iou", "pieces", "merged_with", "missed")
        )


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_random_labellings_score_as_the_other_scorer_has_it(oracle: ModuleType, data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    n = data.draw(st.integers(1, 400))
    truth = rng.integers(0, data.draw(st.integers(1, 8)), n) * data.draw(st.integers(1, 3))
    labels = np.where(rng.random(n) < data.draw(st.floats(0, 1)), truth * 5, rng.integers(0, 8, n) * 5)
    confidence = {i: float(rng.integers(0, 3)) / 2 for i in range(0, 120, 5)}  # ties on purpose
    agrees(score_instances(truth, labels, confidence), oracle.score(None, truth, labels, confidence))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.integers(0, 200))
def test_points_get_the_labels_that_the_other_scorer_gives_them(
    oracle: ModuleType, seed: int, voxels: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    index = np.unique(rng.integers(-6, 6, (voxels, 3)), axis=0).astype(np.int32)
    label = rng.integers(0, 4, len(index)).astype(np.int32)
    points = rng.uniform(-0.3, 0.3, (count, 3))
    theirs, _ = oracle.labels_at_points(points, index, label, 0.04)
    result = labelled_map(index, label)
    assert labels_of_rows(rows_at_points(points, result), result).tolist() == theirs.tolist()


def noisy_labels(points: NDArray[Any], instance: NDArray[Any], seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Voxels of a room as a faulty mapper could leave them: holes, welds, a split, spill, background partly held."""
    rng = np.random.default_rng(seed)
    index, inverse = np.unique(np.floor(points / 0.04).astype(np.int32), axis=0, return_inverse=True)
    label = np.zeros(len(index), np.int32)
    label[inverse] = instance
    label[label == 7] = 6  # a weld
    label[(label == 3) & (index[:, 0] % 2 == 0)] = 70  # a split
    spill = (label == 0) & (rng.random(len(index)) < 0.05)
    label[spill] = rng.integers(1, 90, spill.sum())
    keep = rng.random(len(index)) < 0.8
    return index[keep], label[keep]


@pytest.mark.parametrize("scene", ["dev_living", "dev_bedroom"])
def test_a_noisy_map_of_a_room_scores_as_the_other_scorer_has_it(
    oracle: ModuleType, shared_data: Path, scene: str
) -> None:
    path = shared_data / scene / "gt_points.npz"
    if not path.is_file():
        pytest.skip(f"no {path}")
    with np.load(path) as truth:
        points, instance = truth["points"].astype(np.float64), truth["instance"].astype(np.int64)
        index, label = noisy_labels(points, instance, 1)
        confidence = {i: (i * 37 % 11) / 10 for i in range(100)}
        theirs = {radius: oracle.score_map(truth, index, label, 0.04, confidence, radius) for radius in (1.5, 0)}
    result = labelled_map(index, label)
    for radius, expected in theirs.items():
        labels = labels_of_rows(rows_at_points(points, result, radius), result)
        agrees(score_instances(instance, labels, confidence), expected)
    assert 0 < theirs[1.5]["AP"] < 1
