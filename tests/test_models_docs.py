"""docs/stages.md and docs/models.md work as they stand there."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import graphs
import pytest
from test_perceive import LARGE, record
from worlds import tiny_frames

from openvox.apps.perceive import perceive
from openvox.formats.perception import perception_info, read_masks
from openvox.perception.stages import STAGES, Row

DOCS = Path(__file__).resolve().parents[1] / "docs"


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text("utf-8"), re.DOTALL)


def test_the_stage_that_the_page_adds_finds_what_it_says(tmp_path, monkeypatch):
    file, row = blocks("stages.md", "python")
    (toml,) = blocks("stages.md", "toml")
    module = ModuleType("openvox.perception.det.colored")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(file, "colored.py", "exec"), module.__dict__)
    monkeypatch.setitem(STAGES, "det", {**STAGES["det"], **eval(f"{{{row}}}", {"Row": Row})})
    (tmp_path / "my.toml").write_text(toml)
    frames = tiny_frames(2, camera=LARGE)
    result = perceive(record(tmp_path / "a.mcap", frames), models=tmp_path / "my.toml")
    info = perception_info(result.output)
    assert [stage["name"] for stage in info.stages] == ["colored", "geometry", "minilm"]
    assert info.parameters["det.min_pixels"] == 40
    for frame, found in zip(frames, read_masks(result.output, boxes=True), strict=True):
        rows, columns = (frame.truth_instances == 1).nonzero()  # the red table
        (box,) = found.boxes
        assert box.label == "red thing"
        assert box.corners == pytest.approx((columns.min(), rows.min(), columns.max() + 1, rows.max() + 1), abs=2)


def test_the_page_is_short_enough_to_be_an_example():
    assert len(blocks("stages.md", "python")[0].splitlines()) <= 100


def test_the_stages_that_are_there_are_no_longer_than_the_page_promises():
    folder = DOCS.parent / "openvox" / "perception"
    files = [path for role in STAGES for path in (folder / role).glob("*.py")]
    assert {role for role in STAGES if any(path.parent.name == role for path in files)} == set(STAGES)
    assert {path.name: lines for path in files if (lines := len(path.read_text("utf-8").splitlines())) > 110} == {}


@pytest.mark.parametrize("toml", blocks("models.md", "toml"))
def test_every_example_of_the_page_of_models_names_options_that_there_are(toml):
    import dataclasses
    from importlib import import_module

    for role, table in tomllib.loads(toml).items():
        module, _, name = STAGES[role][table.pop("stage")].where.partition(":")
        kind = getattr(getattr(import_module(module), name), "Options", None)
        assert set(table) <= {field.name for field in dataclasses.fields(kind) if kind} if kind else not table


def test_the_first_example_of_the_page_of_models_runs(tmp_path):
    toml = blocks("models.md", "toml")[0]
    (tmp_path / "my.toml").write_text(toml)
    graphs.looking_detector(tmp_path / "yolov8s-worldv2.onnx", words=2)
    (tmp_path / "words.txt").write_text("cup\nchair\n")
    graphs.image_encoder(tmp_path / "mobile_sam.encoder.onnx")
    graphs.sam_decoder(tmp_path / "mobile_sam.decoder.onnx")
    result = perceive(record(tmp_path / "a.mcap", tiny_frames(1, camera=LARGE)), models=tmp_path / "my.toml")
    assert (result.frames, result.kinds) == (1, {"object": 1})


def test_the_page_names_every_stage():
    page = (DOCS / "models.md").read_text("utf-8")
    assert [name for rows in STAGES.values() for name in rows if f"`{name}`" not in page] == []
