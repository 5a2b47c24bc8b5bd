"""tools/paper_tables on a tiny scene in Replica's layout, and on nothing."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from test_ingest import write_replica
from test_truth_meshes import ply
from worlds import BOXES, tiny_frames, write_png16

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def tool() -> ModuleType:
    spec = importlib.util.spec_from_file_location("paper_tables", ROOT / "tools" / "paper_tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["paper_tables"] = module
    spec.loader.exec_module(module)
    return module


def test_scenes_that_are_not_there_are_said_and_the_papers_figures_stand_alone(
    tool: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tool.main(["--out", str(tmp_path / "out")])
    assert "| room_0 | - | 17.55 | - | 35.82 | - | 52.53 |" in page
    assert "| average of ScanNet | - | 22.84 | - | 54.23 |" in page
    assert "| relevance | paper* | 0.762 | 0.905 | 0.905 | 21 |" in page
    assert "under another protocol" in page
    assert capsys.readouterr().err.count("not there") == 14


def test_the_papers_averages_are_those_of_its_rows(tool: ModuleType) -> None:
    for name, scenes in (("Replica", tool.REPLICA), ("ScanNet", tool.SCANNET)):
        np.testing.assert_allclose(np.mean(list(scenes.values()), axis=0), tool.AVERAGES[name], atol=0.02)


def test_a_scene_is_run_from_frames_to_its_rows(tool: ModuleType, tmp_path: Path) -> None:
    folder = write_replica(tmp_path / "frames" / "room0", [])
    for frame in tiny_frames(2):
        raw = np.rint(frame.depth * 6.5535).astype(np.uint16)
        write_png16(folder / "results" / f"depth{frame.index:06d}.png", raw)
    truth = tmp_path / "truth" / "room_0"
    truth.mkdir(parents=True)
    corners, faces = [], []
    for box in BOXES:  # small triangles all over its top
        for along in np.linspace(0.1, 0.9, 6):
            for across in np.linspace(0.1, 0.9, 6):
                x, y = (box.low[i] + share * (box.high[i] - box.low[i]) for i, share in ((0, along), (1, across)))
                faces.append((tuple(range(len(corners), len(corners) + 3)), box.instance))
                corners += [(x, y, box.high[2]), (x + 0.01, y, box.high[2]), (x, y + 0.01, box.high[2])]
    (truth / "mesh_semantic.ply").write_bytes(ply(corners, faces))
    objects = [{"id": box.instance, "class_id": box.category, "class_name": "box"} for box in BOXES]
    classes = [{"id": number, "name": f"box {number}"} for number in sorted({box.category for box in BOXES})]
    (truth / "info_semantic.json").write_text(json.dumps({"classes": classes, "objects": objects}))
    options = ["--replica", str(tmp_path / "frames"), "--replica-truth", str(tmp_path / "truth"), "--stride", "1"]
    page = tool.main([*options, "--out", str(tmp_path / "out")])
    row = next(line for line in page.splitlines() if line.startswith("| room_0 "))
    assert row.split("|")[2].strip() != "-"
    assert (tmp_path / "out" / "room_0.map.npz").exists()
