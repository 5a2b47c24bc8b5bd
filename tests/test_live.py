"""live: its map is the map that replay makes of what was recorded, whatever was skipped, and also after a crash."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import tiny_frames, truth_masks

from openvox.apps.info import info
from openvox.apps.live import live
from openvox.apps.living import opening
from openvox.apps.living.gauge import Status
from openvox.apps.living.intake import Arrival, intake
from openvox.apps.living.questions import ask
from openvox.apps.living.shared_map import SharedMap, Snapshots
from openvox.apps.loop import run
from openvox.apps.perceive import perceive
from openvox.apps.query import query, query_live
from openvox.apps.recover import recover
from openvox.apps.replay import replay
from openvox.apps.view import view
from openvox.cli import main
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import PRESETS
from openvox.core.parameters import updated
from openvox.core.types import Frame
from openvox.formats.map_npz import read_map
from openvox.formats.perception import FrameMasks, perception_info, read_masks
from openvox.formats.recording import RecordingWriter, read_frames, recording_info
from openvox.formats.trace import read_trace
from openvox.mapper.mapper import Mapper
from openvox.sources.paced import paced
from openvox.view import viewer

SETS = ["masks.min_pixels=0"]


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 24 frames in 2.4 seconds, with its truth as masks."""
    path = tmp_path_factory.mktemp("played") / "tiny.mcap"
    with RecordingWriter(path, source="test", categories={7: "table", 29: "box"}) as writer:
        for frame in tiny_frames(24):
            writer.add(frame)
    perceive(path, frontend="oracle", assignments=["oracle.min_pixels=1"])
    return path


def lived(source: Path, out: Path, **options: Any) -> dict[str, Any]:
    return live(str(source), out=str(out), assignments=SETS, **options)


def assert_replay_makes_the_same(result: dict[str, Any], out: Path) -> None:
    again = replay(Path(result["outputs"]["recording"]), assignments=SETS, out=str(out))
    assert again["digests"] == result["digests"]
    assert (again["frames"], again["looked"]) == (result["frames"], result["looked"])


@pytest.mark.parametrize("rate", [1.0, 4.0, 1000.0])
def test_replay_of_what_was_recorded_gives_the_map_of_the_live_run(played: Path, tmp_path: Path, rate: float) -> None:
    result = lived(played, tmp_path / "run", rate=rate)
    assert result["frames"] == 24
    assert result["looked"] + result["dropped"] == 24
    assert_replay_makes_the_same(result, tmp_path / "again")
    assert result["digests"]["recording"] == recording_info(played).digest
    assert not list(tmp_path.glob("*.partial*"))


def test_a_recording_is_played_at_its_own_pace_times_the_rate() -> None:
    begin = time.monotonic()
    frames = list(paced(tiny_frames(5), 2.0, threading.Event()))  # four tenths of a second at twice the pace
    assert time.monotonic() - begin >= 0.2
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]


def test_a_stopped_run_ends_well_with_what_had_come(played: Path, tmp_path: Path) -> None:
    stop = threading.Event()
    result = lived(played, tmp_path / "run", stop=stop, status=lambda status: stop.set())
    assert 1 <= result["frames"] < 24
    assert_replay_makes_the_same(result, tmp_path / "again")


# ---- frames that are skipped -----------------------------------------------------------------------------------------


class SlowEyes:
    """Sees the truth; the first frame takes until `release`."""

    def __init__(self) -> None:
        self.started, self.release = threading.Event(), threading.Event()
        self.seen: list[int] = []

    def look(self, frame: Frame) -> FrameMasks:
        self.seen.append(frame.index)
        self.started.set()
        assert self.release.wait(30)
        size = (frame.rig.color.height, frame.rig.color.width)
        return FrameMasks(frame.index, frame.stamp_ns, "00" * 32, truth_masks(frame), size)


def test_when_behind_the_oldest_that_wait_are_skipped_and_keep_their_place() -> None:
    eyes, recorded, stop = SlowEyes(), list[int](), threading.Event()

    def source() -> Iterator[Frame]:
        first, *others = tiny_frames(7)
        yield first
        assert eyes.started.wait(30)
        yield from others
        eyes.release.set()

    def record(frame: Frame) -> Frame:
        recorded.append(frame.index)
        return frame

    arrivals = list(intake(source(), record, eyes.look, stop, capacity=2))
    assert recorded == [0, 1, 2, 3, 4, 5, 6]
    assert [arrival.frame.index for arrival in arrivals] == recorded
    assert [arrival.frame.index for arrival in arrivals if arrival.skipped] == [1, 2, 3, 4]
    assert eyes.seen == [0, 5, 6]
    assert [arrival.found is None for arrival in arrivals] == [False, True, True, True, True, False, False]
    assert not arrivals[1].frame.depth.any(), "pixels of a skipped frame are let go"


@pytest.mark.parametrize(("frontend", "waiting"), [(None, 4), ("geometry", 1)])
def test_who_looks_now_looks_at_the_newest_frame_and_a_cache_at_those_that_wait(
    played: Path, frontend: Any, waiting: int
) -> None:
    options = {"rate": 1.0, "follow": False, "perception": None, "chosen": (None, None, 1)}
    stream = opening.open_recording(
        played, frontend=frontend, stop=threading.Event(), decoded=lambda seconds: None, **options
    )
    assert stream.waiting == waiting


def test_skipped_frames_are_marked_counted_and_skipped_by_replay(
    played: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = opening.cached(played.with_suffix(".perception.mcap"))

    def slow(frame: Frame) -> FrameMasks | None:
        time.sleep(0.05)
        return made.look(frame)

    monkeypatch.setattr(opening, "cached", lambda path: opening.Eyes(slow, made.stages, made.encoder, made.dimensions))
    result = lived(played, tmp_path / "run", rate=1000.0, waiting=2)
    assert result["dropped"] >= 10
    skipped = read_map(tmp_path / "run.map.npz").meta["skipped"]
    numbers = [n for first, last in skipped["ranges"] for n in range(first, last + 1)]
    assert skipped["count"] == len(numbers) == result["dropped"]
    assert json.loads(perception_info(tmp_path / "run.perception.mcap").metadata["skipped"]) == skipped
    assert [f.frame for f in read_trace(tmp_path / "run.trace.mcap") if not f.looked] == numbers
    assert [found.index for found in read_masks(tmp_path / "run.perception.mcap")] == sorted({*range(24)} - {*numbers})
    assert len(list(read_frames(tmp_path / "run.mcap"))) == 24
    assert_replay_makes_the_same(result, tmp_path / "again")


@pytest.mark.parametrize("broken", ["record", "look"])
def test_an_error_on_the_way_comes_out_after_the_frames_before_it(broken: str) -> None:
    def fails_at_2(frame: Frame) -> Any:
        if frame.index == 2:
            raise InputError("frame 2 is bad")
        return frame if broken == "record" else None

    fine = {"record": lambda frame: frame, "look": lambda frame: None}
    parts = {**fine, broken: fails_at_2}
    arrivals: list[Arrival] = []
    with pytest.raises(InputError, match="frame 2 is bad"):
        arrivals.extend(intake(tiny_frames(4), parts["record"], parts["look"], threading.Event(), capacity=9))
    stop = threading.Event()
    steps = intake(tiny_frames(4), parts["record"], parts["look"], stop, capacity=9)
    assert [next(steps).frame.index, next(steps).frame.index] == [0, 1]
    steps.close()
    assert stop.is_set()


# ---- crashes ---------------------------------------------------------------------------------------------------------


def test_what_a_crash_after_any_frame_would_leave_replays_and_lacks_at_most_a_second(
    played: Path, tmp_path: Path
) -> None:
    """A killed process leaves the bytes that it had handed to the system: those that a copy of its files has."""
    left: list[tuple[int, Path]] = []

    def crash(status: Status) -> None:
        folder = tmp_path / f"after {status.frames}"
        folder.mkdir()
        for path in tmp_path.glob("run.*.partial"):
            shutil.copy(path, folder)
        left.append((status.frames, folder))

    lived(played, tmp_path / "run", rate=20.0, status=crash)
    assert len(left) == 24
    for count, folder in left[11::4]:  # more than a second has passed
        partial, stamp = folder / "run.mcap.partial", tiny_frames(count)[-1].stamp_ns
        recorded = list(read_frames(partial))
        assert stamp - recorded[-1].stamp_ns <= 1_000_000_000
        assert info(partial)["frames"] == len(recorded)
        result = replay(partial, assignments=SETS, out=str(folder / "again"))
        assert result["frames"] == len(recorded)
        assert result["digests"]["recording"] == recording_info(partial).digest
        mapper = Mapper(updated(PRESETS["openvox"], {"masks.min_pixels": 0}, source="test"))
        masks = {found.index: found.masks for found in read_masks(tmp_path / "run.perception.mcap")}
        saved = {found.index for found in read_masks(folder / "run.perception.mcap.partial")}
        late = [index for index in masks if index not in saved and index < count]
        assert all(stamp - tiny_frames(24)[index].stamp_ns <= 1_000_000_000 for index in late)
        run(((frame, masks[frame.index] if frame.index in saved else None) for frame in recorded), mapper)
        assert result["digests"]["map"] == map_digest(mapper.finish())


def test_a_killed_run_replays_views_and_recovers(played: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "openvox", "live", str(played), "--out", str(tmp_path / "run"), "--set", SETS[0]]
    with subprocess.Popen([*command, "--rate", "0.5"], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:
        partial = tmp_path / "run.mcap.partial"
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline and not (partial.exists() and _frames_of(partial) >= 5):
            time.sleep(0.1)
        os.kill(process.pid, signal.SIGKILL)
    kept = _frames_of(partial)
    assert kept >= 5
    assert not (tmp_path / "run.mcap").exists()
    result = replay(partial, assignments=SETS)
    assert result["frames"] == kept
    assert result["outputs"]["map"] == str(tmp_path / "run.partial.map.npz")
    view([partial], save=tmp_path / "seen.rrd")
    recovered = recover(partial, tmp_path / "saved.mcap")
    assert recovered.digest == result["digests"]["recording"]
    with pytest.raises(InputError, match="a crash has left it; choose another --out"):
        lived(played, tmp_path / "run")


def _frames_of(path: Path) -> int:
    try:
        return sum(1 for _ in read_frames(path))
    except InputError:  # its first record is not there yet
        return 0


# ---- questions -------------------------------------------------------------------------------------------------------


def test_questions_are_answered_while_it_runs_as_the_finished_map_would(played: Path, tmp_path: Path) -> None:
    address: list[str] = []
    answers: dict[int, Any] = {}

    def asks(status: Status) -> None:
        if status.frames in (1, 24):
            answers[status.frames] = query_live(address[0], ["a box", "a table"], top=2)

    lived(played, tmp_path / "run", rate=20.0, ready=address.append, status=asks)
    assert address[0].startswith("127.0.0.1:")
    assert (answers[1]["frame"], answers[24]["frame"]) == (0, 23)
    assert answers[24]["queries"] == query(tmp_path / "run.map.npz", ["a box", "a table"], top=2)["queries"]
    with pytest.raises(InputError, match="is openvox live still running"):
        query_live(address[0], ["a box"])


@pytest.mark.parametrize(
    "line",
    [b"GET / HTTP/1.1\n", b"\n", b"[]\n", b'{"texts": "a", "top": 3}\n', b'{"texts": ["a"], "top": "3"}\n', b"x" * 99],
)
def test_what_is_no_question_is_answered_with_a_sentence(played: Path, tmp_path: Path, line: bytes) -> None:
    from openvox.apps.living.questions import Questions

    with Questions(lambda texts, top: {"queries": []}) as address:
        host, port = address.split(":")
        with socket.create_connection((host, int(port)), timeout=30) as connection:
            connection.sendall(line)
            connection.shutdown(socket.SHUT_WR)
            answer = json.loads(connection.makefile("rb").readline())
        assert answer["error"].startswith("expected one line like")
        assert ask(address, ["a"], 1) == {"queries": []}


@pytest.mark.parametrize("address", ["", "localhost", "127.0.0.1:", "127.0.0.1:99999", "127.0.0.1:x"])
def test_an_address_that_is_none_is_a_sentence(address: str) -> None:
    with pytest.raises(InputError, match="expected HOST:PORT"):
        query_live(address, ["a chair"])


def test_a_frozen_map_is_that_of_its_moment_though_mapping_went_on() -> None:
    frames = tiny_frames(4)
    mapper, other = Mapper(PRESETS["paper"]), Mapper(PRESETS["paper"])
    for number, frame in enumerate(frames):
        mapper.step(frame, truth_masks(frame))
        if number < 2:
            other.step(frame, truth_masks(frame))
        if number == 1:
            make = mapper.frozen()
    then, expected = make(), other.finish()
    assert map_digest(then) == map_digest(expected) != map_digest(mapper.finish())
    assert then.instances == expected.instances
    assert then.state.keys() == expected.state.keys()
    assert all(np.array_equal(then.state[name], expected.state[name]) for name in then.state)


def test_a_map_that_is_asked_between_steps_does_not_change_what_comes(tmp_path: Path) -> None:
    frames = tiny_frames(4)
    alone, asked = Mapper(PRESETS["openvox"]), Mapper(PRESETS["openvox"])
    shared = SharedMap(asked, {"encoder": ""})
    for frame in frames:
        alone.step(frame, truth_masks(frame))
        shared.step(frame, truth_masks(frame))
        assert shared.finish() is shared.finish()
    assert np.array_equal(alone.finish().vote_count, shared.finish().vote_count)
    assert shared.finish().meta == {"encoder": "", "frames": 4, "last": 3}
    with Snapshots(shared, tmp_path / "a.map.npz.partial", seconds=0.01):
        while not (tmp_path / "a.map.npz.partial").exists():
            time.sleep(0.01)
    assert len(read_map(tmp_path / "a.map.npz.partial").voxel_index) == len(shared.finish().voxel_index)


# ---- a recording that is still being written -------------------------------------------------------------------------


def test_a_growing_recording_is_followed_to_its_end(played: Path, tmp_path: Path) -> None:
    frames = list(read_frames(played))

    def write() -> None:
        with RecordingWriter(tmp_path / "robot.mcap", source="test", live=True) as writer:
            for frame in frames:
                writer.add(frame)
                time.sleep(0.02)

    robot = threading.Thread(target=write)
    robot.start()
    while not (tmp_path / "robot.mcap.partial").exists():
        time.sleep(0.01)
    shutil.copy(played.with_suffix(".perception.mcap"), tmp_path / "robot.perception.mcap")
    result = lived(tmp_path / "robot.mcap", tmp_path / "run", follow=True, waiting=24)
    robot.join()
    assert result["frames"] == 24
    assert result["digests"]["recording"] == recording_info(tmp_path / "robot.mcap").digest
    assert_replay_makes_the_same(result, tmp_path / "again")


def test_a_recording_renamed_after_it_was_found_is_read_under_its_final_name(played: Path, tmp_path: Path) -> None:
    shutil.copy(played, tmp_path / "robot.mcap")
    assert len(list(read_frames(tmp_path / "robot.mcap.partial"))) == len(list(read_frames(played)))
    with pytest.raises(InputError, match="there is no file"):
        list(read_frames(tmp_path / "other.mcap.partial"))


def test_a_recording_whose_writer_died_ends_when_nothing_comes_for_long(
    played: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opening, "IDLE", 0.3)
    data = played.read_bytes()
    (tmp_path / "robot.mcap.partial").write_bytes(data[: len(data) // 2])
    shutil.copy(played.with_suffix(".perception.mcap"), tmp_path / "robot.perception.mcap")
    result = lived(tmp_path / "robot.mcap.partial", tmp_path / "run", follow=True, waiting=24)
    assert 0 < result["frames"] < 24


# ---- the command, and bad input --------------------------------------------------------------------------------------


def test_the_command_writes_beside_its_source_under_another_name(
    played: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in (played, played.with_suffix(".perception.mcap")):
        shutil.copy(path, tmp_path)
    before = (tmp_path / "tiny.mcap").read_bytes()
    words = ["live", str(tmp_path / "tiny.mcap"), "--rate", "50", "--set", SETS[0]]
    with pytest.raises(SystemExit, match="0"):
        main([*words, "--json"])
    out, err = capsys.readouterr()
    result = json.loads(out)
    names = ("recording", "perception", "map", "trace", "times")
    suffixes = (".mcap", ".perception.mcap", ".map.npz", ".trace.mcap", ".times.json")
    for name, suffix in zip(names, suffixes, strict=True):
        assert result["outputs"][name] == str(tmp_path / f"tiny-live{suffix}")
    assert set(result["latency_ms"]) == {"mean", "median", "p95"}
    assert "openvox query --live 127.0.0.1:" in err
    assert (tmp_path / "tiny.mcap").read_bytes() == before
    with pytest.raises(SystemExit, match="0"):
        main(words)
    assert "frames were dropped (recorded, not mapped); latency mean" in capsys.readouterr().out


def test_rerun_shows_latency_and_dropped_frames(played: Path, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    lived(played, tmp_path / "run", rate=50.0, rerun=tmp_path / "run.rrd")
    chunks = [one for one in RrdReader(tmp_path / "run.rrd").stream() if str(one.entity_path) == "/stats/milliseconds"]
    assert "latency" in str([chunk.to_record_batch().to_pydict() for chunk in chunks if chunk.is_static])
    assert sum(chunk.num_rows for chunk in chunks if not chunk.is_static) >= 1


def test_a_window_is_ready_before_the_run_and_stays_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    script = "import socket, sys; s = socket.create_server(('127.0.0.1', int(sys.argv[1]))); s.accept(); s.accept()"
    started: list[subprocess.Popen[bytes]] = []

    @contextmanager
    def fake(arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
        assert arguments[:3] == ["--bind", "127.0.0.1", "--port"]
        with subprocess.Popen([sys.executable, "-c", script, arguments[3]]) as process:
            started.append(process)
            yield process

    monkeypatch.setattr(viewer, "has_screen", lambda: True)
    monkeypatch.setattr(viewer, "running", fake)
    with viewer.window() as url:
        viewer.check_url(url)  # the second connection, after which the viewer ends
    assert started[0].returncode == 0


def test_without_a_screen_a_window_is_a_sentence(played: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "has_screen", lambda: False)
    with pytest.raises(InputError, match="there is no screen here; use --connect"):
        lived(played, tmp_path / "run", spawn=True)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"rate": 0.0}, "--rate is 0.0; expected"),
        ({"rate": float("nan")}, "--rate is nan; expected"),
        ({"frontend": "geometry", "perception": Path("a.mcap")}, "masks come from one of them"),
        ({"connect": "http://127.0.0.1:1"}, "no Rerun viewer can be reached"),
        ({"connect": "rerun+http://127.0.0.1:1/proxy"}, "no Rerun viewer can be reached"),
        ({"perception": Path("none.perception.mcap")}, "none.perception.mcap"),
        ({"start": 900}, "there is no frame to record"),
    ],
)
def test_bad_options_are_one_sentence_and_leave_nothing(
    played: Path, tmp_path: Path, options: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        lived(played, tmp_path / "run", **options)
    assert list(tmp_path.iterdir()) == []


def test_the_source_is_never_written_over(played: Path) -> None:
    with pytest.raises(InputError, match="written over what the run reads"):
        lived(played, played.with_suffix(""))


def test_masks_of_other_pixels_end_the_run_but_not_its_recording(played: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    with RecordingWriter(other, source="test") as writer:
        for frame in tiny_frames(3, color_format="png"):
            writer.add(frame)
    with pytest.raises(InputError, match="its masks were made from other pixels than those that come"):
        lived(other, tmp_path / "run", perception=played.with_suffix(".perception.mcap"), rate=1000.0)
    assert _frames_of(tmp_path / "run.mcap.partial") >= 1
