"""perceive on several recordings: side by side, one that fails costs no other and leaves nothing half-written."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from test_perceive import record
from worlds import tiny_frames

from openvox.apps.perceive import PerceiveResult, perceive
from openvox.apps.perceive_several import perceive_several
from openvox.apps.sweeping.pool import Outcome, death
from openvox.core.errors import InputError


def test_each_recording_has_its_result_or_its_error_in_the_order_they_were_given(tmp_path: Path):
    first, blind, last = (
        record(tmp_path / "first.mcap", tiny_frames(3)),
        record(tmp_path / "blind.mcap", tiny_frames(2, truth=False)),
        record(tmp_path / "last.mcap", tiny_frames(2)),
    )
    damaged = tmp_path / "damaged.mcap"
    data = bytearray(first.read_bytes())
    data[len(data) // 2] ^= 1
    damaged.write_bytes(data)
    done: list[tuple[int, int]] = []
    found = perceive_several(
        [first, blind, damaged, last], jobs=2, frontend="oracle", progress=lambda *now: done.append(now)
    )
    a, b, c, d = found.results
    assert isinstance(a, PerceiveResult)
    assert isinstance(d, PerceiveResult)
    assert (a.frames, d.frames) == (3, 2)
    assert "blind.mcap has no ground truth" in str(b)
    assert "damaged.mcap is damaged" in str(c)
    assert found.frames_per_second == pytest.approx(5 / found.seconds)
    assert done == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert sorted(path.name for path in tmp_path.glob("*.perception.mcap*")) == [
        "first.perception.mcap",
        "last.perception.mcap",
    ]
    alone = perceive(first, frontend="oracle", out=tmp_path / "alone.mcap")
    assert alone.output.read_bytes() == a.output.read_bytes()


def test_a_process_that_died_is_told_with_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [record(tmp_path / name, tiny_frames(2)) for name in ("a.mcap", "b.mcap")]

    def died(function: object, tasks: list[Path], jobs: int) -> Iterator[Outcome[PerceiveResult]]:
        yield Outcome(1, None, f"{tasks[1]} is damaged")
        yield Outcome(0, None, death(-9))

    monkeypatch.setattr("openvox.apps.perceive_several.in_processes", died)
    assert perceive_several(paths).results == [
        f"{paths[0]}: its process died (signal 9); if the memory was short, do fewer at a time",
        f"{paths[1]} is damaged",
    ]


SLEEPERS = """
import os, sys, time
from openvox.apps.sweeping.pool import in_processes

def sleep(path):
    open(path, "w").write(str(os.getpid()))
    time.sleep(60)

if __name__ == "__main__":
    list(in_processes(sleep, sys.argv[1:], 2))
"""


def test_processes_end_with_their_parent_even_if_it_is_killed(tmp_path: Path) -> None:
    (tmp_path / "sleepers.py").write_text(SLEEPERS)
    notes = [tmp_path / "a", tmp_path / "b"]
    parent = subprocess.Popen([sys.executable, tmp_path / "sleepers.py", *notes])
    wait_for(lambda: all(note.exists() and note.read_text() for note in notes))
    parent.kill()
    parent.wait()
    wait_for(lambda: not any(Path(f"/proc/{note.read_text()}").exists() for note in notes))


def wait_for(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.05)


def test_the_command_prints_how_fast_each_was_and_all_were(tmp_path: Path, capsys):
    from openvox.cli import main

    paths = [record(tmp_path / name, tiny_frames(2)) for name in ("a.mcap", "b.mcap")]
    lines = []
    for _ in range(2):
        with pytest.raises(SystemExit):
            main(["perceive", *map(str, paths), "--frontend", "oracle"])
        lines.append(re.sub(r"[0-9.]+ (s|frames/s)", r"N \1", capsys.readouterr().out).splitlines())
    each = "2 frames looked at, 2 masks (2 objects), N s, N frames/s, captions encoded by minilm, models on the CPU"
    assert [line for line in lines[0] if "looked at" in line] == [f"{path}: {each}" for path in paths]
    assert lines[0][-1] == "in all: 2 of 2 recordings, N s, N frames/s"
    assert lines[1][-1] == "in all: 2 of 2 recordings, N s"


def test_one_recording_twice_would_write_over_itself(tmp_path: Path):
    path = record(tmp_path / "a.mcap", tiny_frames(1))
    with pytest.raises(InputError, match=r"a.mcap is given twice; give it once"):
        perceive_several([path, tmp_path / "." / "a.mcap"], frontend="oracle")


def test_no_jobs_are_a_sentence(tmp_path: Path):
    with pytest.raises(InputError, match=r"--jobs is 0; expected 1 or more"):
        perceive_several([tmp_path / "a", tmp_path / "b"], jobs=0)
