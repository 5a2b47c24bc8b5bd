"""query --png and --rerun: the answers lit in the map."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from maps import META, labelled_map
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from test_cli import run

from openvox.apps.answers import query_and_show
from openvox.apps.query import query
from openvox.core.errors import InputError, OutputError
from openvox.formats.map_npz import write_map
from openvox.perception.encoder import encoder
from openvox.view.answers import BEST, HEIGHT, MARGIN, NEXT, TITLE, WIDTH

CAPTIONS = {2: "a grey sofa", 5: "a coffee mug", 9: "a green houseplant"}


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    """Three blocks side by side, a sofa, a mug and a plant."""
    block = np.stack(np.meshgrid(range(4), range(4), range(4), indexing="ij"), -1).reshape(-1, 3)
    index = np.concatenate([block + np.array([8 * k, 0, 0]) for k in range(3)])
    vectors = encoder("minilm").encode(list(CAPTIONS.values()))
    result = labelled_map(
        index,
        np.repeat([*CAPTIONS], len(block)),
        voxel_size=0.1,
        captions=CAPTIONS,
        features=dict(zip(CAPTIONS, vectors, strict=True)),
        meta={**META, "encoder": "minilm"},
    )
    write_map(tmp_path / "a.map.npz", result)
    return tmp_path / "a.map.npz"


def like(picture: NDArray[np.uint8], color: tuple[int, int, int]) -> int:
    """Pixels of this hue and about this saturation, however they are lit."""
    wanted = cv2.cvtColor(np.array([[color]], np.uint8), cv2.COLOR_RGB2HSV)[0, 0].astype(int)
    seen = cv2.cvtColor(picture, cv2.COLOR_RGB2HSV).astype(int)
    return int(((np.abs(seen - wanted) < [6, 25, 256]).all(-1)).sum())


def test_the_best_answer_stands_out_and_the_next_are_paler(map_file: Path, tmp_path: Path) -> None:
    found = query_and_show(map_file, ["a couch", "a fire extinguisher"], top=2, png=tmp_path / "a.png")
    assert found["queries"] == query(map_file, ["a couch", "a fire extinguisher"], top=2)["queries"]
    assert found["outputs"] == {"png": str(tmp_path / "a.png"), "rerun": None}
    picture = cv2.imread(str(tmp_path / "a.png"))[..., ::-1]
    assert picture.shape == (2 * (TITLE + HEIGHT + MARGIN), WIDTH + 2 * MARGIN, 3)
    for part in np.split(picture, 2):
        best, others = like(np.ascontiguousarray(part), BEST), like(np.ascontiguousarray(part), NEXT)
        assert best > 5000  # one of three blocks that fill the picture
        assert others > 5000


def test_one_answer_lights_one_thing(map_file: Path, tmp_path: Path) -> None:
    query_and_show(map_file, ["a couch"], top=1, png=tmp_path / "a.png")
    assert like(np.ascontiguousarray(cv2.imread(str(tmp_path / "a.png"))[..., ::-1]), NEXT) < 500


def test_rerun_gets_a_view_a_question(map_file: Path, tmp_path: Path) -> None:
    query_and_show(map_file, ["a couch", "a plant"], top=1, rerun=tmp_path / "a.rrd")
    drawn = {str(chunk.entity_path) for chunk in RrdReader(str(tmp_path / "a.rrd")).stream()}
    shown = sorted(path for path in drawn if path.startswith("/world/answers/"))
    assert shown == [f"/world/answers/{path}" for path in ("00/0002", "00/rest", "01/0009", "01/rest")]


def test_the_command_names_what_it_wrote(map_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("query", map_file, "a couch", "--png", tmp_path / "a.png") == 0
    assert f"wrote {tmp_path / 'a.png'}" in capsys.readouterr().out
    assert run("query", map_file, "a couch", "--json") == 0
    assert "outputs" not in json.loads(capsys.readouterr().out)


def test_names_of_other_files_and_bad_questions_write_nothing(map_file: Path, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"let its name end with .png"):
        query_and_show(map_file, ["a couch"], png=map_file)
    with pytest.raises(OutputError, match=r"let its name end with .rrd"):
        query_and_show(map_file, ["a couch"], rerun=map_file)
    with pytest.raises(InputError, match="is empty"):
        query_and_show(map_file, [" "], png=tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.map.npz"]
