"""What instances are called: captions of many views as votes, a name only where it was given often and surely."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from maps import small_map, summary
from strategies import rectangle

from openvox.core.errors import InputError
from openvox.formats.map_npz import read_map, write_map
from openvox.mapper.codebook import NAMED, NAMELESS, Fragment, Said, memory_of, name_of, said_of

ONE = 4096
CUP, MUG, FORM = ("cup", "a white cup"), ("mug", "a white mug"), ("", "a small white object")


def test_each_caption_of_a_mask_has_support_by_its_score_and_the_masks_credibility():
    mask = rectangle(
        0, 0, 4, 4, label="cup", caption="a white cup", caption_score=0.5, alternatives=(("mug", "a white mug", 0.25),)
    )
    assert said_of(mask, ONE) == [(CUP, ONE // 2), (MUG, ONE // 4)]
    assert said_of(mask, ONE // 2) == [(CUP, ONE // 4), (MUG, ONE // 8)]


def test_a_caption_that_names_nothing_has_little_support():
    mask = rectangle(0, 0, 4, 4, label="object", caption=FORM[1], named=False)
    assert said_of(mask, ONE) == [(FORM, ONE // NAMELESS)]


def test_a_mask_without_a_caption_says_nothing_and_one_without_a_label_is_labelled_by_its_caption():
    assert said_of(rectangle(0, 0, 4, 4), ONE) == []
    assert said_of(rectangle(0, 0, 4, 4, caption="a cup"), ONE) == [(("a cup", "a cup"), ONE)]


def test_the_label_with_most_support_decides_though_another_caption_has_more():
    said = {("cup", "a white cup"): 30, ("cup", "a grey cup"): 25, ("vase", "a white vase"): 40}
    assert name_of(said, 100) == ("a white cup", True)


def test_equal_support_goes_by_text():
    assert name_of({("b", "a b"): 9, ("a", "the a"): 5, ("a", "an a"): 4}, 9) == ("the a", True)
    assert name_of({("a", "x"): 5, ("a", "w"): 5}, 9) == ("w", True)


def test_too_little_support_is_no_name():
    said = {CUP: 10, MUG: 9, FORM: 1}
    assert name_of(said, 10 * NAMED) == ("a white cup", True)
    assert name_of(said, 10 * NAMED + 1) == ("a small white object", False)
    assert name_of({CUP: 10}, 10 * NAMED + 1) == ("a white cup", False)  # there is nothing else to say
    assert name_of({FORM: 50}, 10) == ("a small white object", False)
    assert name_of({}, 10) == ("", False)


@given(
    st.dictionaries(
        st.tuples(st.sampled_from(["", "a", "b"]), st.sampled_from(["x", "y", "z"])), st.integers(0, 50), max_size=6
    ),
    st.integers(0, 400),
)
def test_a_name_is_a_caption_that_was_given_with_a_label(said: dict[Said, int], weight: int):
    caption, named = name_of(said, weight)
    labels = {label for label, text in said if text == caption}
    assert bool(caption) is bool(said)
    assert not named or labels - {""}


def test_fragments_of_an_instance_are_asked_together():
    parts = []
    for number, said in enumerate([{CUP: 3, MUG: 5}, {CUP: 4}], 1):
        part = Fragment(number, 0, 9, np.zeros(2, np.int64))
        part.observe(20, None, said.items())
        parts.append(part)
    memory = memory_of(parts)
    assert (memory.caption, memory.named, memory.weight) == ("a white cup", True, 40)
    assert memory.captions == (("a white cup", 7), ("a white mug", 5))


def test_a_mask_refuses_an_alternative_with_an_impossible_score():
    with pytest.raises(InputError, match=r"mask scores are 1.0, 1.0, 1.5; expected numbers between 0 and 1"):
        rectangle(0, 0, 4, 4, alternatives=(("cup", "a cup", 1.5),))


def test_a_map_keeps_whether_a_caption_is_a_name(tmp_path: Path):
    plain = small_map()
    instances = (summary(2, "a lamp", 1, named=False), *plain.instances[1:])
    write_map(tmp_path / "a.map.npz", replace(plain, instances=instances))
    assert [one.named for one in read_map(tmp_path / "a.map.npz").instances] == [False, True]
