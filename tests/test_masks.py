"""COCO compressed run lengths, against pycocotools and by hand; hostile texts are refused."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pycocotools import mask as coco

from openvox.core.errors import InputError
from openvox.formats.masks import decode_rle, encode_rle

bitmaps = st.tuples(st.integers(1, 12), st.integers(1, 12)).flatmap(lambda size: arrays(np.bool_, size))


def coco_text(bitmap: np.ndarray) -> str:
    return coco.encode(np.asfortranarray(bitmap.astype(np.uint8)))["counts"].decode()


def test_a_mask_by_hand_runs_down_the_columns_zeros_first():
    bitmap = np.array([[0, 1, 1], [0, 0, 1]], np.bool_)
    # Down the columns: 0 0 | 1 0 | 1 1 -> two 0, one 1, one 0, two 1; the last is written as 2 - 1 = +1.
    assert encode_rle(bitmap) == "2111"
    assert (decode_rle("2111", 2, 3) == bitmap).all()


@given(bitmaps)
def test_a_bitmap_survives_and_the_text_is_that_of_pycocotools(bitmap):
    text = encode_rle(bitmap)
    assert text == coco_text(bitmap)
    assert (decode_rle(text, *bitmap.shape) == bitmap).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_picture_with_long_and_falling_runs_agrees_with_pycocotools(seed):
    rng = np.random.default_rng(seed)
    bitmap = np.zeros((480, 640), np.bool_)
    for _ in range(8):
        y, x = rng.integers(0, 400), rng.integers(0, 500)
        bitmap[y : y + rng.integers(1, 80), x : x + rng.integers(1, 140)] ^= True
    text = coco_text(bitmap)
    assert encode_rle(bitmap) == text
    assert (decode_rle(text, 480, 640) == bitmap).all()


@pytest.mark.parametrize("bitmap", [np.zeros((3, 2), np.bool_), np.ones((3, 2), np.bool_)])
def test_all_empty_and_all_full_masks_agree_with_pycocotools(bitmap):
    assert encode_rle(bitmap) == coco_text(bitmap)
    assert (decode_rle(encode_rle(bitmap), 3, 2) == bitmap).all()


@pytest.mark.parametrize(
    ("counts", "sentence"),
    [
        ("2110", "cover 5 pixels; expected 6"),
        ("2112", "cover 7 pixels; expected 6"),
        ("", "cover 0 pixels; expected 6"),
        ("21O1111", "negative length"),
        ("2R", "break off within a number"),
        ("2 11", "a character that COCO"),
        ("2é1", "a character that COCO"),
        ("ooooooo0", "no picture is large enough"),
        ("o" * 40 + "0", "no picture is large enough"),
    ],
)
def test_counts_that_do_not_fit_are_refused_in_a_sentence(counts, sentence):
    with pytest.raises(InputError, match=sentence):
        decode_rle(counts, 2, 3)


@pytest.mark.parametrize("size", [(0, 3), (3, -1), (40_000, 3), (30_000, 30_000)])
def test_a_size_that_no_mask_has_is_refused_before_any_allocation(size):
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=r"mask is .* pixels; expected sides"):
            decode_rle("0", *size)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_huge_runs_are_refused_before_any_allocation():
    longest = "ooooo?"  # five groups of 31 with more to follow, then 15: 2**29 - 1
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="hold runs that 6 pixels have no room for"):
            decode_rle(longest + longest, 2, 3)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


@given(st.text(st.characters(min_codepoint=40, max_codepoint=120), max_size=40), st.integers(1, 5), st.integers(1, 5))
def test_any_text_is_a_bitmap_of_the_right_size_or_a_sentence(counts, height, width):
    try:
        found = decode_rle(counts, height, width)
    except InputError:
        return
    assert found.shape == (height, width)


def test_runs_whose_sum_would_wrap_around_are_refused():
    huge = "ooooo?"
    for counts in (huge * 3, "0" * 100_000):
        with pytest.raises(InputError, match=r"no room for|letters long"):
            decode_rle(counts, 8, 8)
