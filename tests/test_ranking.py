"""Ranking of instances by a text: a soft maximum over captions by their support, and what things are for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from maps import labelled_map

from openvox.apps.ranking import DOUBT, SHARPNESS, likeness
from openvox.apps.uses import ANOTHER_THING, USE_OF, USES, in_short, use_of
from openvox.core.types import InstanceMap

INDEX = np.array([[0, 0, 0], [5, 5, 5]], np.int32)
AXES = {"q": (1.0, 0.0), "same": (1.0, 0.0), "other": (0.0, 1.0), "half": (0.6, 0.8), "for": (1.0, 0.0)}


class Flat:
    """An encoder of a few words, by hand."""

    def encode(self, texts: Sequence[str]) -> np.ndarray:
        return np.array([AXES[text] for text in texts], np.float32).reshape(len(texts), 2)


def said(captions: Mapping[int, tuple[tuple[str, float], ...]], weight: float = 0.0) -> InstanceMap:
    """Instances 1 and 2 of which that was said, where captions that are sure would have that support."""
    import dataclasses

    plain = labelled_map(
        INDEX, np.array([1, 2], np.int32), captions={1: "", 2: ""}, features={1: AXES["other"], 2: AXES["half"]}
    )
    instances = tuple(dataclasses.replace(one, captions=captions.get(one.id, ())) for one in plain.instances)
    return dataclasses.replace(plain, instances=instances, feature_weight=np.full(2, weight))


def test_an_instance_of_one_caption_is_as_alike_as_the_caption():
    scores = likeness(said({1: (("same", 3.0),), 2: (("half", 0.1),)}), Flat(), ["q"])
    np.testing.assert_allclose(scores, [[1.0, 0.6]], atol=1e-6)


def test_a_caption_given_rarely_still_counts_where_it_fits_far_better():
    scores = likeness(said({1: (("other", 3.0), ("same", 1.0))}), Flat(), ["q"])
    expected = SHARPNESS * np.log((0.75 * np.exp(0.0) + 0.25 * np.exp(1 / SHARPNESS)) / 1)
    assert scores[0, 0] == pytest.approx(expected)
    assert 0.9 < scores[0, 0] < 1.0


def test_where_little_is_known_an_answer_falls_behind():
    sure = likeness(said({1: (("same", 5.0),)}, weight=10.0), Flat(), ["q"])[0, 0]
    vague = likeness(said({1: (("same", 0.1),)}, weight=10.0), Flat(), ["q"])[0, 0]
    assert sure == pytest.approx(1 + SHARPNESS * np.log(5 / (5 + 10 * DOUBT)))
    assert vague == pytest.approx(1 + SHARPNESS * np.log(0.1 / (0.1 + 10 * DOUBT)))
    assert vague < sure


def test_without_captions_the_feature_is_compared():
    np.testing.assert_allclose(likeness(said({}), Flat(), ["q"]), [[0.0, 0.6]], atol=1e-6)


def test_a_use_that_fits_better_than_the_caption_counts_half(monkeypatch):
    monkeypatch.setattr("openvox.apps.ranking.use_of", {"half": "for", "same": "other"}.get)
    scores = likeness(said({1: (("half", 1.0),), 2: (("same", 1.0),)}), Flat(), ["q"])
    np.testing.assert_allclose(scores, [[(0.6 + 1.0) / 2, 1.0]], atol=1e-6)  # a use that fits less does no harm


def test_a_kind_of_thing_is_as_like_as_the_thing_where_that_fits_better(monkeypatch):
    monkeypatch.setattr("openvox.apps.ranking.in_short", {"half": "same", "same": "other"}.get)
    scores = likeness(said({1: (("half", 1.0),), 2: (("same", 1.0),)}), Flat(), ["q"])
    np.testing.assert_allclose(scores, [[1.0, 1.0]], atol=1e-6)


def test_a_table_is_found_by_its_name_rather_than_by_a_rare_word_of_what_has_none():
    import dataclasses

    from openvox.perception.encoder import encoder

    doubtful = (("a red cabinet", 1.5), ("a red desk", 0.7), ("a red table", 0.6), ("a red bench", 0.5))
    result = said({1: doubtful, 2: (("a beige dining table", 10.0),)}, weight=30.0)
    result = dataclasses.replace(result, feature=np.zeros((2, 384), np.float32))
    scores = likeness(result, encoder("minilm"), ["a table"])
    assert scores[0, 1] > scores[0, 0]


@pytest.mark.parametrize(
    ("caption", "short"),
    [
        ("a beige dining table on a rug", "a beige table"),
        ("a white coffee cup", "a white cup"),
        ("a beige table", ""),
        ("a small white object on a table-high surface", ""),
        ("a remote control", ""),
        ("a hot dog", ""),
        ("", ""),
    ],
)
def test_the_kind_of_a_thing_can_be_left_out(caption, short):
    assert in_short(caption) == short


def test_what_is_no_kind_of_its_last_word_is_a_known_noun():
    assert set(USE_OF) >= ANOTHER_THING
    assert all(noun.split()[-1] in USE_OF for noun in ANOTHER_THING)


def test_texts_and_instances_may_be_none():
    assert likeness(said({}), Flat(), []).shape == (0, 2)


@pytest.mark.parametrize(
    ("caption", "noun"),
    [
        ("a white cup", "cup"),
        ("a grey office chair with wheels", "office chair"),
        ("a white coffee cup on a dining table", "coffee cup"),
        ("A Remote Control.", "remote control"),
        ("a potted plant", "potted plant"),
    ],
)
def test_a_caption_is_about_the_last_noun_before_where_it_is(caption, noun):
    assert use_of(caption) == USE_OF[noun]


@pytest.mark.parametrize(
    "caption", ["", "a small white object on a table-high surface", "on", "a large thing of a bed"]
)
def test_what_has_no_known_noun_has_no_known_use(caption):
    assert use_of(caption) == ""


def test_every_noun_has_one_use_and_the_front_ends_nouns_have_one():
    import json

    from openvox.perception.namer import FOLDER

    assert len(USE_OF) == sum(len(nouns.split(",")) for nouns in USES)
    nouns = set(json.loads((FOLDER / "indoor_nouns.json").read_text()).values())
    assert {noun for noun in nouns if not use_of(noun)} == set()
