"""view: what is shown of each kind of file, what a trace gives back without mapping, and who can connect."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maps import small_map
from rerun.chunk import RrdReader
from worlds import tiny_frames

from openvox.apps.loop import run
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.apps.retrace import Pictures, steps_of
from openvox.apps.view import as_rrd, kind, view
from openvox.core.errors import InputError, OutputError
from openvox.core.mapper_parameters import preset
from openvox.core.types import InstanceMap, Step
from openvox.formats.map_npz import write_map
from openvox.formats.perception import read_masks
from openvox.formats.recording import RecordingWriter, read_frames
from openvox.mapper.mapper import Mapper
from openvox.view.viewer import free_port


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a tiny recording, its perception, map, trace and what replay shows of the run."""
    folder = tmp_path_factory.mktemp("run")
    with RecordingWriter(folder / "tiny.mcap", source="test") as writer:
        for frame in tiny_frames(6):
            writer.add(frame)
    perceive(folder / "tiny.mcap", frontend="oracle", assignments=["oracle.min_pixels=1"])
    replay(folder / "tiny.mcap", assignments=["masks.min_pixels=0"], rerun=folder / "tiny.rrd")
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return Path(shutil.copytree(made, tmp_path / "copy"))


def rows(path: Path) -> dict[tuple[str, Any, str], list[str]]:
    """Every value of an .rrd by entity, frame and component; its name and layout apart."""
    out: dict[tuple[str, Any, str], list[str]] = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path.startswith("/__") or chunk.entity_path == "/stats/milliseconds":  # a replay's own
            continue
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if "RowId" not in name and name != "sensor_time"]
        for row in range(batch.num_rows):
            frame = batch.column("frame")[row].as_py() if "frame" in names else None
            for name in names:
                value = batch.column(name)[row]
                if name != "frame" and value.is_valid:
                    out.setdefault((chunk.entity_path, frame, name), []).append(repr(value.as_py()))
    return out


class Kept:
    """An observer that keeps all steps."""

    def __init__(self) -> None:
        self.steps: list[Step] = []

    def on_step(self, step: Step) -> None:
        self.steps.append(step)

    def close(self, result: InstanceMap) -> None:
        """Nothing is left to do."""


def test_a_trace_shows_all_that_replay_showed_without_mapping(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Mapper, "step", None)
    shown, expected = rows(as_rrd(folder / "tiny.trace.mcap", folder / "again.rrd")), rows(folder / "tiny.rrd")
    assert {entity for entity, _, _ in shown} >= {"/decisions/data", "/decisions/graph", "/camera/detected/color"}
    assert shown == expected


def test_the_steps_of_a_trace_are_those_of_the_mapper(folder: Path) -> None:
    masks = {found.index: found.masks for found in read_masks(folder / "tiny.perception.mcap")}
    kept, parameters = Kept(), preset("openvox")
    run(((frame, masks[frame.index]) for frame in read_frames(folder / "tiny.mcap")), Mapper(parameters), [kept])
    replay(folder / "tiny.mcap", out=str(folder / "plain"))
    told = list(steps_of(folder / "plain.trace.mcap", Pictures(folder / "tiny.mcap", folder / "tiny.perception.mcap")))
    assert len(told) == len(kept.steps) == 6
    for a, b in zip(told, kept.steps, strict=True):
        assert (a.frame.index, a.looked, a.decisions, a.voxels) == (b.frame.index, b.looked, b.decisions, b.voxels)
        assert dict(a.instance_of) == dict(b.instance_of)
        for name in ("new_index", "voxel", "fragment", "count", "touched", "owner", "share"):
            assert np.array_equal(getattr(a.changes, name), getattr(b.changes, name)), name


def test_a_trace_alone_is_shown_without_pictures_and_says_so(folder: Path) -> None:
    (folder / "tiny.mcap").unlink()
    said: list[str] = []
    shown = rows(as_rrd(folder / "tiny.trace.mcap", folder / "again.rrd", notice=said.append))
    expected = rows(folder / "tiny.rrd")
    assert said == [f"the recording {folder / 'tiny.mcap'} is not there: shown without pictures"]
    entities = {entity for entity, frame, _ in shown if frame is not None}
    assert not any(entity.startswith("/camera") or entity == "/world/trajectory" for entity in entities)
    for key in expected:
        entity, frame, what = key
        if entity in ("/decisions/graph", "/events") or entity.startswith("/world/instances"):
            beside_best_views = frame is None and (what == "votes" or what.startswith("EncodedImage"))
            assert beside_best_views or shown[key] == expected[key]


def test_the_recording_of_a_trace_may_lie_elsewhere_but_must_be_the_same(folder: Path) -> None:
    moved = (folder / "tiny.mcap").rename(folder / "moved.mcap")
    said: list[str] = []
    shown = as_rrd(folder / "tiny.trace.mcap", folder / "again.rrd", moved, said.append)
    assert rows(shown) == rows(folder / "tiny.rrd")
    assert not said
    with RecordingWriter(folder / "other.mcap", source="test") as writer:
        writer.add(tiny_frames(1)[0])
    with pytest.raises(InputError, match=r"other.mcap is another recording than that of .*tiny.trace.mcap"):
        as_rrd(folder / "tiny.trace.mcap", folder / "again.rrd", folder / "other.mcap")


def test_a_trace_needs_the_map_of_its_run(folder: Path) -> None:
    write_map(folder / "tiny.map.npz", small_map())
    with pytest.raises(InputError, match=r"tiny.map.npz is of another run than"):
        as_rrd(folder / "tiny.trace.mcap", folder / "again.rrd")
    (folder / "tiny.map.npz").unlink()
    with pytest.raises(InputError, match=r"its map .* is not there; put it beside the trace"):
        as_rrd(folder / "tiny.trace.mcap", folder / "again.rrd")
    assert not list(folder.glob("again.rrd*"))


def test_a_recording_is_shown_with_its_masks_and_its_depth(folder: Path) -> None:
    shown = rows(as_rrd(folder / "tiny.mcap", folder / "recording.rrd"))
    for entity in ("color", "masks"):
        assert {frame for path, frame, _ in shown if path == f"/world/camera/{entity}"} == set(range(6))
    assert {frame for path, frame, _ in shown if path == "/world/depth_camera/depth"} == set(range(6))
    units = [values for key, values in shown.items() if key[2] == "EncodedDepthImage:meter"]
    assert units == [["[1000.0]"]] * 6
    assert rows(as_rrd(folder / "tiny.perception.mcap", folder / "perception.rrd")) == shown


def test_a_recording_without_perception_is_shown_without_masks(folder: Path) -> None:
    (folder / "tiny.perception.mcap").unlink()
    said: list[str] = []
    shown = rows(as_rrd(folder / "tiny.mcap", folder / "recording.rrd", notice=said.append))
    assert said == [f"{folder / 'tiny.perception.mcap'} is not there: shown without masks"]
    pixels = {values[0] for key, values in shown.items() if key[2] == "SegmentationImage:buffer"}
    assert len(pixels) == 1  # all clear


def test_a_map_is_shown_by_instance_with_captions_and_what_belongs_to_none(tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", small_map())
    shown = rows(as_rrd(tmp_path / "a.map.npz", tmp_path / "a.rrd"))
    assert shown["/world/instances/0005", None, "caption"] == ["['ein grüner Stuhl']"]
    assert shown["/world/instances/0002", None, "instance"] == ["[2]"]
    cells = {path: values[0] for (path, _, name), values in shown.items() if name == "VoxelGridMap:voxel_indices"}
    assert cells["/world/instances/0002"] == "[[-1, 0, 0], [0, 0, 1]]"
    assert cells["/world/structure"] == "[[3, 0, 0]]"


def test_a_foreign_file_is_one_sentence_that_names_what_can_be_shown(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(InputError, match=r"a.txt is no recording, perception, map, trace or .rrd"):
        view([tmp_path / "a.txt"])
    with pytest.raises(InputError, match=r"missing.mcap cannot be read"):
        kind(tmp_path / "missing.mcap")


def test_without_a_screen_it_says_what_else_there_is(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match=r"there is no screen here; use --web .* --save OUT.rrd .* openvox shot"):
        view([folder / "tiny.trace.mcap"])


def test_save_never_overwrites_its_input_and_takes_one_file(folder: Path) -> None:
    with pytest.raises(InputError, match=r"--save writes one file, 2 were given"):
        view([folder / "tiny.mcap", folder / "tiny.map.npz"], save=folder / "a.rrd")
    before = (folder / "tiny.rrd").read_bytes()
    with pytest.raises(OutputError, match=r"a.png would be a file for Rerun under another name"):
        view([folder / "tiny.map.npz"], save=folder / "a.png")
    with pytest.raises(InputError, match=r"is an .rrd already"):
        view([folder / "tiny.rrd"], save=folder / "a.rrd")
    assert (folder / "tiny.rrd").read_bytes() == before


def test_a_port_that_is_taken_is_one_sentence() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} of 127.0.0.1 cannot be had"):
            free_port("127.0.0.1", port)


@pytest.fixture
def temporary(tmp_path: Path) -> Path:
    """Where `served` puts what is temporary."""
    path = tmp_path / "temporary"
    path.mkdir()
    return path


@pytest.fixture
def served(folder: Path, temporary: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`openvox view --web` as a process of its own, and the URL that it printed."""
    command = [sys.executable, "-m", "openvox", "view", str(folder / "tiny.map.npz"), "--web"]
    environment = {**os.environ, "PYTHONUNBUFFERED": "1", "TMPDIR": str(temporary)}
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests in the background have it ignored
    )
    assert process.stdout is not None
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="the kernel does not list its sockets here")
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_the_web_viewer_listens_on_this_machine_only_and_ends_when_told(
    served: tuple[subprocess.Popen[str], str], temporary: Path, end: signal.Signals
) -> None:
    process, url = served
    assert url.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(url, timeout=10) as page:
        assert b"rerun" in page.read().lower()
    ours = family(process.pid)
    listening = [address for pid in ours for address in listeners(pid)]
    assert len(listening) == 2
    assert set(listening) == {"0100007F"}
    process.send_signal(end)
    assert process.wait(20) == 0
    assert not any(Path(f"/proc/{pid}").exists() for pid in ours)
    assert not list(temporary.iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="no other system can be told so")
def test_the_viewer_dies_with_an_openvox_that_is_killed(served: tuple[subprocess.Popen[str], str]) -> None:
    process, _ = served
    (server,) = family(process.pid)[1:]
    process.kill()
    process.wait()
    patience = time.monotonic() + 20
    while running(server) and time.monotonic() < patience:
        time.sleep(0.1)
    assert not running(server)


def running(pid: int) -> bool:
    """Whether a process is there, and no zombie that nobody has asked after."""
    try:
        return ") Z " not in Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False


def family(pid: int) -> list[int]:
    """A process and its children."""
    return [pid, *map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())]


def listeners(pid: int) -> list[str]:
    """Addresses on which a process listens, IPv4 and IPv6, as the kernel writes them."""
    sockets = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        target = os.readlink(link) if link.is_symlink() else ""
        if target.startswith("socket:["):
            sockets.add(target[8:-1])
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in sockets:  # 0A: listening
                found.append(fields[1].split(":")[0])
    return found
