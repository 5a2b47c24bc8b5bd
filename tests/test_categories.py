"""Categories of instances, and the colours that view and report give them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from maps import META, labelled_map
from rerun.chunk import RrdReader
from test_cli import run

from openvox.apps.categories import UNNAMED, categories_of
from openvox.apps.report import report
from openvox.apps.uses import noun_of
from openvox.core.colors import category_colors, instance_color
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import write_map
from openvox.perception.encoder import encoder

CAPTIONS = {2: "a grey sofa", 5: "a coffee mug on a table", 9: "a red sofa", 11: ""}
INDEX = np.array([[0, 0, 0], [1, 0, 0], [5, 5, 5], [7, 0, 0]], np.int32)


def room(meta: dict[str, str] | None = None) -> InstanceMap:
    vectors = encoder("minilm").encode(["a grey sofa", "a coffee mug", "a red sofa", "a thing"])
    return labelled_map(
        INDEX,
        np.array([*CAPTIONS]),
        captions=CAPTIONS,
        features=dict(zip(CAPTIONS, vectors, strict=True)),
        meta={**META, "encoder": "minilm"} if meta is None else meta,
    )


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    write_map(tmp_path / "a.map.npz", room())
    return tmp_path / "a.map.npz"


@pytest.mark.parametrize(
    ("caption", "noun"),
    [
        ("a grey sofa", "sofa"),
        ("a white coffee cup on a table", "coffee cup"),
        ("There is a low coffee table with a mosaic top.", "coffee table"),
        ("a tall white bookcase full of books", "bookcase"),
        ("a pair of running shoes", "shoes"),
        ("a brown chest of drawers", "chest of drawers"),
        ("a close up of a green vegetable", "vegetable"),
        ("a side table next to another object", "side table"),
        ("the bowl is white", "bowl"),
        ("a zorbulator", "zorbulator"),
        ("full", "full"),
        ("", ""),
        (" . ", ""),
    ],
)
def test_the_noun_of_a_caption_is_the_thing_itself(caption: str, noun: str) -> None:
    assert noun_of(caption) == noun


def test_without_classes_a_category_is_the_noun_of_the_caption() -> None:
    assert categories_of(room(), None) == ("sofa", "mug", "sofa", UNNAMED)


def test_a_caption_that_only_describes_gives_no_category() -> None:
    plain = room()
    first = replace(plain.instances[0], caption="a small white object on the floor", named=False)
    assert categories_of(replace(plain, instances=(first, *plain.instances[1:])), None)[0] == UNNAMED


def test_with_classes_it_is_the_nearest_name(tmp_path: Path) -> None:
    names = tmp_path / "names.txt"
    names.write_text("drinking_vessel\nseat\n")
    assert categories_of(room(), names)[:3] == ("seat", "drinking_vessel", "seat")
    with pytest.raises(InputError, match=r"--classes .*names.txt cannot be used: the map has no embeddings"):
        categories_of(room({}), names)


def test_one_name_has_one_colour_and_names_take_colours_in_order() -> None:
    assert category_colors(["sofa", "mug", "sofa"]) == [instance_color(2), instance_color(1), instance_color(2)]


def test_a_report_can_be_coloured_by_category(map_file: Path, tmp_path: Path) -> None:
    report(map_file, None, tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', text)
    assert data is not None
    (shown,) = json.loads(data[1])["maps"]
    palettes = {palette["name"]: palette["colors"] for palette in shown["palettes"]}
    assert list(palettes) == ["instance", "confidence", "category"]
    assert palettes["category"] == [list(color) for color in category_colors(["sofa", "mug", "sofa", UNNAMED])]
    assert '<option value="category">by category</option>' in text
    assert "category: sofa" in text


def test_a_report_takes_names_of_categories(map_file: Path, tmp_path: Path) -> None:
    names = tmp_path / "names.txt"
    names.write_text("vessel\nseat\n")
    report(map_file, None, tmp_path / "a.html", classes=names)
    assert "category: seat" in (tmp_path / "a.html").read_text(encoding="utf-8")
    with pytest.raises(InputError, match="only the page of one map has categories"):
        report(map_file, map_file, tmp_path / "b.html", classes=names)


def test_rerun_has_the_categories_as_a_view(map_file: Path, tmp_path: Path) -> None:
    assert run("view", map_file, "--save", tmp_path / "a.rrd") == 0
    drawn = {str(chunk.entity_path) for chunk in RrdReader(str(tmp_path / "a.rrd")).stream()}
    assert {f"/world/categories/{number:04d}" for number in CAPTIONS} <= drawn


def test_classes_are_refused_where_nothing_has_categories(
    map_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("view", map_file, "--save", tmp_path / "a.rrd", "--classes", tmp_path / "none.txt") == 1
    assert "cannot be read" in capsys.readouterr().err
    assert not (tmp_path / "a.rrd").exists()
    assert run("view", tmp_path / "a.rrd", "--classes", tmp_path / "none.txt") == 1
