"""The library: the programs of docs/library.md run as they stand, and give the maps that the commands give."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from worlds import tiny_frames

import openvox
from openvox import RecordingWriter, map_digest, read_map
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay

PAGE = Path(__file__).resolve().parents[1] / "docs" / "library.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    with RecordingWriter(Path("living.mcap"), source="test", categories={7: "table", 29: "box"}) as writer:
        for frame in tiny_frames(6):
            writer.add(frame)
    perceive(Path("living.mcap"), frontend="oracle", assignments=["oracle.min_pixels=1"])
    return tmp_path


def test_the_first_program_has_less_than_twenty_lines_and_makes_the_map_of_replay(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert len(PROGRAMS[0].splitlines()) < 20
    exec(PROGRAMS[0], {})
    made = map_digest(read_map(folder / "living.map.npz"))
    assert made == replay(Path("living.mcap"), out="again")["digests"]["map"]
    assert " new 1 mask" in capsys.readouterr().out


def test_the_robots_program_finds_its_box(capsys: pytest.CaptureFixture[str]) -> None:
    assert len(PROGRAMS[1].splitlines()) < 20
    exec(PROGRAMS[1], {})
    assert capsys.readouterr().out.startswith("[(1, 'a red box', ((")


def test_a_live_run_from_python(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exec(PROGRAMS[2], {})
    assert replay(Path("robot.mcap"), out="again")["digests"]["map"] in capsys.readouterr().out
    assert len(PROGRAMS) == 3


def test_every_name_of_the_library_is_there_and_no_other() -> None:
    assert all(getattr(openvox, name) is not None for name in openvox.__all__)
    assert sorted(openvox.__all__) == sorted(openvox._MODULE_OF)
    with pytest.raises(AttributeError, match="has no attribute 'mapper_of_dreams'"):
        openvox.mapper_of_dreams  # noqa: B018
