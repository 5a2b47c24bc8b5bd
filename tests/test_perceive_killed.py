"""perceive, killed where it cannot clean up: it goes on from what is whole, to the bytes of an uninterrupted run."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from test_perceive import LARGE, record
from worlds import tiny_frames

from openvox.apps.perceive import perceive

DIES = """
import os, signal, sys
from pathlib import Path
from openvox.apps.perceive import perceive
from openvox.formats.perception import PerceptionWriter

add = PerceptionWriter.add

def dying(self, found):
    add(self, found)
    if self.frames == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)

PerceptionWriter.add = dying
perceive(Path(sys.argv[1]), frontend="geometry")
"""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Frames a second apart: each is a chunk of the file, so that it is whole on the disk when the next begins."""
    frames = [replace(frame, stamp_ns=i * 1_000_000_000) for i, frame in enumerate(tiny_frames(8, camera=LARGE))]
    return record(tmp_path / "a.mcap", frames)


def test_killed_again_and_again_it_ends_with_the_same_bytes(recording, tmp_path):
    whole = perceive(recording, frontend="geometry").output
    expected = whole.read_bytes()
    whole.unlink()
    for frames in (3, 1, 5, 4, 7):  # a later kill may come earlier
        command = [sys.executable, "-c", DIES, str(recording), str(frames)]
        assert subprocess.run(command, check=False, timeout=120).returncode == -signal.SIGKILL
        assert not whole.exists()
    again = perceive(recording, frontend="geometry")
    assert again.output.read_bytes() == expected
    assert again.reused >= 5
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.mcap", "a.perception.mcap"]


def test_killed_over_an_older_file_that_stays_until_the_new_one_is_whole(recording, tmp_path):
    expected = perceive(recording, frontend="geometry").output.read_bytes()
    older = perceive(recording, frontend="geometry", assignments=["geometry.far=4"])
    before = older.output.read_bytes()
    command = [sys.executable, "-c", DIES, str(recording), "6"]
    assert subprocess.run(command, check=False, timeout=120).returncode == -signal.SIGKILL
    assert older.output.read_bytes() == before
    again = perceive(recording, frontend="geometry")
    assert again.reused > 0
    assert again.output.read_bytes() == expected
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.mcap", "a.perception.mcap"]
