"""Boxes: what is put into a rectangle comes back whole, and of like boxes the best stay."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from openvox.perception.det.boxes import box_iou, letterboxed, suppressed

sides = st.integers(1, 200)


@settings(deadline=None)
@given(sides, sides, st.integers(8, 96), st.integers(8, 96))
def test_the_place_of_the_picture_in_the_rectangle_is_the_whole_picture(height, width, rows, columns):
    rgb = np.full((height, width, 3), 255, np.uint8)
    rectangle, place = letterboxed(rgb, rows, columns, 114)
    bright = rectangle[0, 0] == 1
    y, x = np.flatnonzero(bright.any(1)), np.flatnonzero(bright.any(0))
    assert bright[y[0] : y[-1] + 1, x[0] : x[-1] + 1].all()
    assert y[0] == 0 or x[0] == 0  # it touches two opposite sides: no smaller than it could be
    corners = np.array([[x[0], y[0], x[-1] + 1, y[-1] + 1]], np.float32)
    np.testing.assert_allclose(place.undone(corners, width, height), [[0, 0, width, height]], atol=1e-3)


boxes = st.tuples(st.integers(0, 20), st.integers(0, 20), st.integers(1, 20), st.integers(1, 20))
rows = st.lists(st.tuples(boxes, st.integers(0, 4), st.integers(0, 2)), max_size=12)


@settings(deadline=None)
@given(rows, st.sampled_from([0.3, 0.5, 0.7]), st.sampled_from([0.5, 0.8, 1.0]))
def test_what_stays_overlaps_little_and_what_goes_has_a_better_one_over_it(found, same, other):
    corners = np.array([(x, y, x + w, y + h) for (x, y, w, h), _, _ in found], np.float32).reshape(-1, 4)
    scores = np.array([score / 4 for _, score, _ in found], np.float32)
    kinds = np.array([kind for _, _, kind in found], np.int64)
    kept = suppressed(corners, scores, kinds, same, other)

    def over(i: int, j: int) -> bool:
        return box_iou(corners[i], corners[j]) > (same if kinds[i] == kinds[j] else other)

    assert [scores[i] for i in kept] == sorted((scores[i] for i in kept), reverse=True)
    assert not any(over(i, j) for i in kept for j in kept if i != j)
    for gone in set(range(len(found))) - set(kept):
        assert any(over(gone, i) and scores[i] >= scores[gone] for i in kept)


@pytest.mark.parametrize(
    ("a", "b", "iou"),
    [
        ((0, 0, 4, 2), (2, 0, 6, 2), 4 / 12),
        ((0, 0, 4, 4), (0, 0, 4, 4), 1.0),
        ((0, 0, 4, 4), (4, 0, 8, 4), 0.0),
        ((1, 1, 1, 1), (1, 1, 1, 1), 0.0),
    ],
)
def test_iou_is_the_common_area_over_that_of_both(a, b, iou):
    assert box_iou(np.array(a, np.float32), np.array(b, np.float32)) == pytest.approx(iou)
