"""recover: every whole chunk of a broken file is kept, what was lost is said, and no byte leads to nonsense."""

from __future__ import annotations

import json
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from test_damaged_recordings import records
from worlds import tiny_frames

from openvox.apps.perceive import perceive
from openvox.apps.recover import RecoverResult, recover
from openvox.apps.replay import replay
from openvox.cli import main
from openvox.core.digest import START, frame_digest, recording_link
from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics
from openvox.formats.mcap_io import MAGIC
from openvox.formats.perception import perception_info, read_masks
from openvox.formats.recording import RecordingWriter, read_frames, recording_info
from openvox.formats.trace import read_trace, trace_info

FRAMES = tiny_frames(12, stride=5)  # half a second apart: two frames a chunk
RECORDING = {"/camera/color", "/camera/color/calibration", "/camera/depth", "/camera/depth/calibration", "/tf"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording of six chunks, its perception, its map and its trace."""
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    with RecordingWriter(path, source="test", categories={7: "table"}, extra={"notes": '["made by a test"]'}) as writer:
        for frame in FRAMES:
            writer.add(frame)
    perceive(path, frontend="oracle")
    replay(path)
    return path


def chain_of(frames: list[Frame]) -> str:
    link = START
    for frame in frames:
        link = recording_link(link, frame_digest(frame), frame)
    return link


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Offset and length of every chunk record."""
    return [(at, length) for opcode, at, length in records(data) if opcode == Opcode.CHUNK]


def saved(data: bytes, folder: Path) -> tuple[RecoverResult, list[int]]:
    """What recover makes of these bytes, and the numbers of the frames that it kept."""
    (folder / "broken.mcap").write_bytes(data)
    result = recover(folder / "broken.mcap", folder / "saved.mcap")
    return result, [frame.index for frame in read_frames(folder / "saved.mcap")]


def test_of_a_whole_file_nothing_is_lost(whole: Path, tmp_path: Path) -> None:
    result = recover(whole, tmp_path / "b.mcap")
    assert (result.kind, result.lost, result.digest) == ("recording", (), recording_info(whole).digest)
    assert result.kept == dict.fromkeys(sorted({*RECORDING, "/truth/instances", "/truth/categories"}), 12)
    info = recording_info(tmp_path / "b.mcap")
    assert (info.digest, info.categories, info.source) == (result.digest, {7: "table"}, "test")
    assert json.loads(info.metadata["notes"]) == ["made by a test"]


def test_a_file_cut_in_a_chunk_keeps_the_chunks_before_it(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    at, length = chunks(data)[3]
    result, kept = saved(data[: at + length // 2], tmp_path)
    assert kept == [0, 5, 10, 15, 20, 25]
    assert result.digest == recording_info(tmp_path / "saved.mcap").digest == chain_of(FRAMES[:6])
    # frame 25 has the stamp 3.5 s; nothing whole comes after it
    assert {(loss["from"], loss["to"]) for loss in result.lost} == {(3_500_000_000, None)}
    assert {loss["topic"] for loss in result.lost} == {*RECORDING, "/truth/instances", "/truth/categories"}


def test_a_damaged_chunk_in_the_middle_is_skipped_and_its_time_is_said(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    at, length = chunks(bytes(data))[2]
    data[at + length // 2] ^= 1
    result, kept = saved(bytes(data), tmp_path)
    assert kept == [0, 5, 10, 15, 30, 35, 40, 45, 50, 55]
    assert {(loss["from"], loss["to"], loss["reason"]) for loss in result.lost} == {
        (2_500_000_000, 4_000_000_000, "a damaged chunk")
    }
    assert result.digest == chain_of([*FRAMES[:4], *FRAMES[6:]])


def test_the_first_chunk_may_be_lost_where_the_end_still_names_the_topics(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    data[chunks(bytes(data))[0][0] + 60] ^= 1
    result, kept = saved(bytes(data), tmp_path)
    assert kept == [frame.index for frame in FRAMES[2:]]
    assert {(loss["from"], loss["to"]) for loss in result.lost} == {(None, 2_000_000_000)}
    (tmp_path / "broken.mcap").write_bytes(data[:-1])
    with pytest.raises(InputError, match="there is no frame to record"):
        recover(tmp_path / "broken.mcap", tmp_path / "none.mcap")
    assert not (tmp_path / "none.mcap").exists()


@pytest.mark.parametrize("opcode", [0x07, 0x0F, 0x0E, 0x46])
def test_a_chunk_that_calls_itself_something_else_does_not_vanish_unsaid(
    whole: Path, tmp_path: Path, opcode: int
) -> None:
    data = bytearray(whole.read_bytes())
    data[chunks(bytes(data))[2][0]] = opcode
    result, kept = saved(bytes(data), tmp_path)
    assert kept == [0, 5, 10, 15, 30, 35, 40, 45, 50, 55]
    assert len(result.lost) == 7


def test_where_only_the_end_is_broken_nothing_is_lost(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    end = next(at for opcode, at, _ in records(data) if opcode == Opcode.DATA_END)
    for broken in (data[: end + 5], data[:-1], data[: end + 20] + b"\xff" * 9 + data[end + 29 :]):
        result, kept = saved(broken, tmp_path)
        assert (result.lost, len(kept)) == ((), 12)


def test_an_unfinished_file_is_saved_and_what_was_not_written_counts_as_lost(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    with RecordingWriter(path, source="test") as writer:
        for frame in FRAMES:
            writer.add(frame)
        (tmp_path / "copy.mcap.partial").write_bytes((tmp_path / "b.mcap.partial").read_bytes())
    result = recover(tmp_path / "copy.mcap.partial", path)
    assert result.kept["/tf"] >= 8
    assert {(loss["to"], loss["reason"]) for loss in result.lost} == {(None, "the file was never finished")}
    assert recording_info(path).frames == result.kept["/tf"]


def test_a_frame_that_lost_its_picture_with_a_neighbouring_chunk_is_left_out(tmp_path: Path) -> None:
    """A chunk that ends between a frame's depth and its colour: the frame is in two chunks, and needs both."""
    big = [  # random depth does not pack: every depth picture fills a chunk of its own
        Frame(**{**frame.__dict__, "depth": np.random.default_rng(i).integers(1, 9000, (768, 1024)).astype(np.uint16)})
        for i, frame in enumerate(large_frames(4))
    ]
    with RecordingWriter(tmp_path / "a.mcap", source="test") as writer:
        for frame in big:
            writer.add(frame)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    data[chunks(bytes(data))[2][0] + 500] ^= 1  # colour of frame 1 and depth of frame 2
    _, kept = saved(bytes(data), tmp_path)
    assert kept == [0, 3]


def large_frames(count: int) -> list[Frame]:
    camera = Intrinsics(1024, 768, 800.0, 800.0, 511.5, 383.5)
    return tiny_frames(count, camera=camera, truth=False)


def test_a_broken_perception_keeps_its_frames_and_its_recording(whole: Path, tmp_path: Path) -> None:
    path = whole.with_name("a.perception.mcap")
    same = recover(path, tmp_path / "same.mcap")
    assert (same.kind, same.lost, same.digest) == ("perception", (), perception_info(path).digest)
    data = path.read_bytes()
    at, length = chunks(data)[2]
    (tmp_path / "cut.mcap").write_bytes(data[: at + length - 3])
    result = recover(tmp_path / "cut.mcap", tmp_path / "sub.mcap")
    found = list(read_masks(tmp_path / "sub.mcap", boxes=True))
    assert [one.index for one in found] == [0, 5, 10, 15]
    assert [len(one.masks) for one in found] == [len(one.masks) for one in read_masks(path, end=20)]
    assert len(result.lost) == 4
    info = perception_info(tmp_path / "sub.mcap")
    assert info.recording_digest == recording_info(whole).digest
    assert info.recording == "a.mcap"  # beside the broken copy, as the original named it


def test_a_recovered_perception_elsewhere_still_names_its_recording(whole: Path, tmp_path: Path) -> None:
    recover(whole.with_name("a.perception.mcap"), tmp_path / "b.mcap")
    assert (tmp_path / perception_info(tmp_path / "b.mcap").recording).resolve() == whole.resolve()


def test_a_broken_trace_keeps_its_frames(whole: Path, tmp_path: Path) -> None:
    path = whole.with_name("a.trace.mcap")
    same = recover(path, tmp_path / "same.mcap")
    assert (same.kind, same.lost, same.digest) == ("trace", (), trace_info(path).digest)
    assert [step.decisions for step in read_trace(tmp_path / "same.mcap")] == [s.decisions for s in read_trace(path)]
    data = path.read_bytes()
    at, _ = chunks(data)[3]
    (tmp_path / "cut.mcap").write_bytes(data[: at + 9])
    result = recover(tmp_path / "cut.mcap", tmp_path / "b.mcap")
    assert [step.frame for step in read_trace(tmp_path / "b.mcap")] == [0, 5, 10, 15, 20, 25]
    assert {loss["to"] for loss in result.lost} == {None}
    run = trace_info(tmp_path / "b.mcap").run
    assert run["preset"] == "openvox"


def test_a_recovered_recording_replays_to_the_same_map_as_its_frames(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    at, length = chunks(bytes(data))[5]
    data[at + length // 2] ^= 1
    saved(bytes(data), tmp_path)
    perceive(tmp_path / "saved.mcap", frontend="oracle")
    expected = replay(whole, out=str(tmp_path / "first"), end=50)
    assert replay(tmp_path / "saved.mcap")["digests"]["map"] == expected["digests"]["map"]


def places_and_bits(size: int) -> st.SearchStrategy[tuple[int, int]]:
    return st.tuples(st.integers(0, size - 1), st.integers(1, 255))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_wherever_bytes_are_cut_or_changed_every_untouched_chunk_is_kept_and_the_rest_is_said(
    whole: Path, tmp_path: Path, data: st.DataObject
) -> None:
    broken = bytearray(whole.read_bytes())
    size = len(broken)
    flips = data.draw(st.lists(places_and_bits(size), max_size=4, unique_by=lambda flip: flip[0]))
    cut = data.draw(st.integers(0, size)) if data.draw(st.booleans()) else size
    for at, bits in flips:
        broken[at] ^= bits
    places = chunks(whole.read_bytes())
    hit = {n for n, (at, length) in enumerate(places) for f, _ in flips if at <= f < at + length}
    hit |= {n for n, (at, length) in enumerate(places) if at + length > cut}
    expected = [frame for n in range(6) if n not in hit for frame in FRAMES[2 * n : 2 * n + 2]]
    end_known = cut == size and not any(at > places[-1][0] + places[-1][1] for at, _ in flips)
    begins = {at for at, _ in flips if at < places[0][0]}
    try:
        result, kept = saved(bytes(broken[:cut]), tmp_path)
    except InputError:
        assert len(hit) == 6 or (0 in hit and not end_known) or begins
        return
    if not begins and (0 not in hit or end_known):
        # no CRC covers the times in a chunk's head, which are not used either: such a chunk is kept
        assert {frame.index for frame in expected} <= set(kept)
    assert result.digest == chain_of([frame for frame in FRAMES if frame.index in kept])
    assert bool(result.lost) == (len(kept) < len(FRAMES)) or cut < size


def test_claims_of_gigabytes_cost_nothing(whole: Path, tmp_path: Path) -> None:
    """A length beyond the file, a chunk that unpacks to much, a chunk head in nonsense: all are skipped."""
    data = whole.read_bytes()
    (first, length), last = chunks(data)[0], chunks(data)[5]
    bomb = data[first : first + 25] + struct.pack("<Q", 1 << 40) + data[first + 33 : first + length]
    nonsense = b"\x06" + struct.pack("<Q", 1 << 60) + bytes(28) + b"\x04\0\0\0zstd" + bytes(500)
    tracemalloc.start()
    result, kept = saved(data[: last[0]] + bomb + nonsense + data[last[0] :], tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert kept == [frame.index for frame in FRAMES]
    assert result.lost == ()  # the frames' chain is the one that the file states
    assert peak < 20_000_000


def test_chunks_out_of_order_are_left_out_and_said(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    places = chunks(data)
    twice = data[: places[3][0]] + data[places[0][0] : sum(places[0])] + data[places[3][0] : places[5][0]]
    result, kept = saved(twice, tmp_path)
    assert kept == [frame.index for frame in FRAMES[:10]]
    assert any("frame numbers must rise" in loss["reason"] for loss in result.lost)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "has 0 bytes"),
        (b"no recording at all", "has no whole chunk"),
        (MAGIC + b"\x06" + b"\xff" * 200, "has no whole chunk"),
        (MAGIC * 2, "has no whole chunk"),
    ],
)
def test_what_has_nothing_to_save_is_one_sentence(content: bytes, expected: str, tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    (tmp_path / "b.mcap").write_bytes(b"older")
    with pytest.raises(InputError, match=expected):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert (tmp_path / "b.mcap").read_bytes() == b"older"


def test_paths_that_cannot_be_are_one_sentence(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not there"):
        recover(tmp_path / "a.mcap", tmp_path / "b.mcap")
    with pytest.raises(InputError, match="a folder"):
        recover(tmp_path, tmp_path / "b.mcap")
    with pytest.raises(InputError, match="written over"):
        recover(whole, whole)
    with pytest.raises(InputError, match="written over"):
        recover_into_its_own_partial(tmp_path)


def recover_into_its_own_partial(folder: Path) -> None:
    (folder / "c.mcap.partial").write_bytes(MAGIC)
    recover(folder / "c.mcap.partial", folder / "c.mcap")


def test_the_command_ends_with_3_when_something_was_lost(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: chunks(data)[4][0] + 100])
    words = ["recover", str(tmp_path / "cut.mcap"), str(tmp_path / "b.mcap")]
    for more, code in (([], 3), (["--json"], 3)):
        with pytest.raises(SystemExit) as end:
            main([*words, *more])
        assert end.value.code == code
    table, _, line = capsys.readouterr().out.strip().rpartition("\n")
    assert "the end" in table
    assert json.loads(line)["kept"]["/tf"] == 8
    with pytest.raises(SystemExit) as end:
        main(["recover", str(whole), str(tmp_path / "b.mcap")])
    assert end.value.code == 0
    assert "nothing was lost" in capsys.readouterr().out
