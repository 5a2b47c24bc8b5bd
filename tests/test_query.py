"""query: the instances that fit a text best."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from maps import META, labelled_map

from openvox.apps.query import FITS, query
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import write_map
from openvox.perception.encoder import encoder

CAPTIONS = {2: "a grey sofa", 5: "a coffee mug", 9: "a green houseplant"}
INDEX = np.array([[0, 0, 0], [1, 0, 0], [5, 5, 5], [-3, 0, 0], [9, 9, 9]], np.int32)
LABEL = np.array([2, 2, 5, 9, 0], np.int32)


def room(meta: dict[str, str] | None = None) -> InstanceMap:
    vectors = encoder("minilm").encode(list(CAPTIONS.values()))
    return labelled_map(
        INDEX,
        LABEL,
        voxel_size=0.1,
        captions=CAPTIONS,
        features=dict(zip(CAPTIONS, vectors, strict=True)),
        meta={**META, "encoder": "minilm"} if meta is None else meta,
    )


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    write_map(tmp_path / "a.map.npz", room())
    return tmp_path / "a.map.npz"


def test_the_best_instance_comes_first_with_where_it_is(map_file: Path) -> None:
    (answer,) = query(map_file, ["a couch"], top=1)["queries"]
    (best,) = answer["answers"]
    assert (answer["text"], answer["found"]) == ("a couch", True)
    assert list(best) == ["instance", "caption", "score", "center", "bounds", "voxels"]
    assert (best["instance"], best["caption"], best["voxels"]) == (2, "a grey sofa", 2)
    assert best["center"] == pytest.approx([0.1, 0.05, 0.05])  # of the centres 0.05 and 0.15 along x
    assert best["bounds"] == [[0, 0, 0], [pytest.approx(0.2), pytest.approx(0.1), pytest.approx(0.1)]]


def test_scores_say_how_well_an_answer_fits_and_fall(map_file: Path) -> None:
    texts = ["something to drink from", "a plant"]
    drink, plant = query(map_file, texts, top=9)["queries"]
    assert [one["answers"][0]["instance"] for one in (drink, plant)] == [5, 9]
    scores = [one["score"] for one in drink["answers"]]
    assert len(scores) == 3
    assert scores == sorted(scores, reverse=True)


def test_what_is_not_there_is_not_found_and_the_nearest_are_told(map_file: Path) -> None:
    there, missing = query(map_file, ["a sofa", "a fire extinguisher"])["queries"]
    assert there["found"]
    assert not missing["found"]
    assert len(missing["answers"]) == 3
    assert missing["answers"][0]["score"] < FITS <= there["answers"][0]["score"]


def test_equal_instances_come_by_id(tmp_path: Path) -> None:
    vector = encoder("minilm").encode(["a chair"])[0]
    result = labelled_map(
        INDEX,
        LABEL,
        features=dict.fromkeys((2, 5, 9), vector),
        captions=dict.fromkeys((2, 5, 9), "a chair"),
        meta={"encoder": "minilm"},
    )
    write_map(tmp_path / "a.map.npz", result)
    (answer,) = query(tmp_path / "a.map.npz", ["a chair"])["queries"]
    assert [one["instance"] for one in answer["answers"]] == [2, 5, 9]


def test_a_map_without_instances_finds_nothing(tmp_path: Path) -> None:
    empty = labelled_map(INDEX, np.zeros(5, np.int32), meta={"encoder": "minilm"})
    write_map(tmp_path / "a.map.npz", empty)
    assert query(tmp_path / "a.map.npz", ["x"])["queries"] == [{"text": "x", "found": False, "answers": []}]


@pytest.mark.parametrize(
    ("meta", "sentence"),
    [
        ({}, r"a.map.npz cannot be asked in words: the map has no embeddings"),
        ({"encoder": "clip"}, r"a.map.npz cannot be asked in words: there is no encoder 'clip'"),
    ],
)
def test_a_map_that_cannot_be_asked_says_why(tmp_path: Path, meta: dict[str, str], sentence: str) -> None:
    write_map(tmp_path / "a.map.npz", room(meta))
    with pytest.raises(InputError, match=sentence):
        query(tmp_path / "a.map.npz", ["x"])


def test_features_of_another_length_are_refused(tmp_path: Path) -> None:
    short = replace(room(), feature=np.eye(3, dtype=np.float32))
    write_map(tmp_path / "a.map.npz", short)
    with pytest.raises(InputError, match="features have 3 numbers, vectors of minilm 384"):
        query(tmp_path / "a.map.npz", ["x"])


def test_an_empty_text_or_no_answers_asked_for_is_an_error(map_file: Path) -> None:
    with pytest.raises(InputError, match="a text to look for is empty"):
        query(map_file, ["sofa", " "])
    with pytest.raises(InputError, match="--top is 0; expected 1 or more"):
        query(map_file, ["sofa"], top=0)
