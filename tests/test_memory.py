"""--max-memory ends a run in one sentence, and leaves nothing half-written."""

from __future__ import annotations

from pathlib import Path

import pytest
from worlds import tiny_frames

from openvox.apps import memory
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.core.errors import InputError
from openvox.formats.recording import RecordingWriter


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.mcap"
    with RecordingWriter(path, source="test", categories={1: "box"}) as writer:
        for frame in tiny_frames(3):
            writer.add(frame)
    perceive(path, frontend="oracle", assignments=["oracle.min_pixels=1"])
    return path


def test_a_run_that_needs_more_ends_in_a_sentence_and_leaves_nothing(recording: Path) -> None:
    with pytest.raises(
        InputError, match=r"frame 0: \d+ MB .* map of \d+ voxels, --max-memory is 1; that is the program"
    ):
        replay(recording, max_memory=1)
    assert not list(recording.parent.glob("tiny.map*"))
    assert not list(recording.parent.glob("tiny.trace*"))


def test_what_finishing_will_take_counts(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "memory_in_use", lambda: 0)
    voxels = replay(recording, max_memory=1000)["voxels"]
    monkeypatch.setattr(memory, "memory_in_use", lambda: 5_000_000 - 200 * voxels)
    assert replay(recording, max_memory=5)["voxels"] == voxels
    monkeypatch.setattr(memory, "memory_in_use", lambda: 6_000_001 - 200 * voxels)
    with pytest.raises(InputError, match=r"frame 2: 6 MB are needed"):
        replay(recording, max_memory=5)


def test_where_the_map_is_what_takes_the_memory_a_coarser_one_is_the_cure(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "FINISHING", 100_000_000)
    with pytest.raises(InputError, match=r"choose a larger map\.voxel_size, or --end 0"):
        replay(recording, max_memory=500)


def test_memory_in_use_is_that_of_a_python_process() -> None:
    assert 10_000_000 < memory.memory_in_use() < 10**11
