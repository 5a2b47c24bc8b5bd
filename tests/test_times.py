"""Times of a run: a file beside the trace, which has none, so that traces of equal runs stay equal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from worlds import tiny_frames

from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.apps.timing import Ran
from openvox.core.errors import InputError
from openvox.core.types import Frame, Step, VoxelChanges
from openvox.formats.recording import RecordingWriter
from openvox.formats.times import Times, read_times, times_path, write_times


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Four frames of a tiny world, of which perception looked at 0 and 2."""
    path = tmp_path / "tiny.mcap"
    with RecordingWriter(path, source="test") as writer:
        for frame in tiny_frames(4):
            writer.add(frame)
    perceive(path, frontend="oracle", assignments=["oracle.min_pixels=1"], stride=2)
    return path


def step(frame: Frame, looked: bool) -> Step:
    import numpy as np

    none = np.zeros(0, np.int32)
    changes = VoxelChanges(0, np.zeros((0, 3), np.int32), none, none, none, none, none, none)
    return Step(frame, (), looked, (), (), changes, {}, 0)


def test_replay_writes_the_milliseconds_of_each_stage_and_frame_beside_the_trace(recording: Path) -> None:
    result = replay(recording, assignments=["masks.min_pixels=0"])
    times = read_times(Path(result["outputs"]["times"]))
    assert Path(result["outputs"]["times"]) == recording.with_name("tiny.times.json")
    assert (times.trace, times.frames) == (result["digests"]["trace"], [0, 1, 2, 3])
    assert set(times.stages) == {"decode", "masks", "project", "associate", "evolve", "trace"}
    assert all(value is not None for value in (*times.stages["decode"], *times.stages["trace"]))
    assert [value is None for value in times.stages["project"]] == [False, True, False, True]


def test_a_second_run_has_other_times_and_the_same_trace(recording: Path) -> None:
    traces = []
    for name in ("a", "b"):
        made = replay(recording, assignments=["masks.min_pixels=0"], out=str(recording.with_name(name)))
        traces.append((Path(made["outputs"]["trace"]).read_bytes(), made["digests"]["trace"]))
    assert traces[0] == traces[1]


def test_the_last_pass_counts_and_a_stage_stands_at_the_frames_it_ran_in() -> None:
    ran = Ran()
    for frame, looked in zip(tiny_frames(3), (True, False, True), strict=True):
        ran.on_step(step(frame, looked))
    times = ran.times("ab", {"decode": [9.0, 9.0, 9.0, 1.0, 2.0, 3.0], "evolve": [9.0, 9.0, 4.0, 5.0], "cut": []})
    assert times.stages == {"decode": [1.0, 2.0, 3.0], "evolve": [4.0, None, 5.0]}


def test_what_was_written_is_read_to_a_microsecond(tmp_path: Path) -> None:
    path = times_path(tmp_path / "a.trace.mcap")
    write_times(path, Times("ab", [3, 5], {"decode": [1.23456, 2.0], "evolve": [None, 0.5]}))
    times = read_times(path)
    assert (path.name, times.trace, times.frames) == ("a.times.json", "ab", [3, 5])
    assert times.stages == {"decode": [1.235, 2.0], "evolve": [None, 0.5]}


GOOD: dict[str, Any] = {"format_version": 1, "trace": "ab", "frames": [0, 1], "milliseconds": {"decode": [1.0, 2.0]}}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frames": [0, "x"]}, "its frames are no numbers"),
        ({"frames": [0, None]}, "its frames are no numbers"),
        ({"frames": {"0": 1, "1": 2}}, "its frames are no numbers"),
        ({"milliseconds": {"decode": [1.0]}}, "not a number a frame"),
        ({"milliseconds": {"decode": [1.0, float("nan")]}}, "not a number a frame"),
        ({"milliseconds": {"decode": [1.0, -1]}}, "not a number a frame"),
        ({"milliseconds": {"decode": [True, 1]}}, "not a number a frame"),
        ({"milliseconds": []}, "does not hold the times of a run"),
        ({"trace": None, "format_version": 2}, "use a newer openvox"),
    ],
)
def test_what_is_no_file_of_times_is_one_sentence(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    (tmp_path / "a.times.json").write_text(json.dumps({**GOOD, **changes}))
    with pytest.raises(InputError, match=words):
        read_times(tmp_path / "a.times.json")


@pytest.mark.parametrize("text", ["", "[]", "[" * 100_000, '{"format_version": 1}', '{"format_version": "1"}'])
def test_broken_files_of_times_are_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.times.json").write_text(text)
    with pytest.raises(InputError, match="does not hold the times of a run"):
        read_times(tmp_path / "a.times.json")
    with pytest.raises(InputError, match="cannot be read"):
        read_times(tmp_path / "none.times.json")
