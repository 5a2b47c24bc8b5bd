"""Damaged, unfinished, foreign and hostile recordings: one sentence each, never nonsense, a hang or gigabytes."""

from __future__ import annotations

import re
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zstandard
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer
from worlds import tiny_frames

from openvox.core.digest import START, frame_digest, recording_link
from openvox.core.errors import InputError
from openvox.formats.mcap_io import MAGIC
from openvox.formats.recording import METADATA, RecordingWriter, read_frames, recording_info

SENTENCE = re.compile(r"[^\n]+")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The bytes of a small recording of three chunks."""
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    with RecordingWriter(path, source="test") as writer:
        for frame in tiny_frames(4, stride=5):
            writer.add(frame)
    return path.read_bytes()


def read_all(path: Path) -> tuple[str, str, int]:
    """Everything that a reader can learn of a recording, as digests."""
    info = recording_info(path)
    link = START
    pictures = 0
    for frame in read_frames(path):
        link = recording_link(link, frame_digest(frame), frame)
        for ids in (frame.truth_instances, frame.truth_categories):
            assert ids is not None
            pictures = zlib.crc32(ids.tobytes(), pictures)
    return info.digest, link, pictures


def outcome(path: Path) -> tuple[str, str, int] | None:
    """As read_all; None if the recording is refused."""
    try:
        return read_all(path)
    except InputError:
        return None


def sentence(path: Path) -> str:
    """The one sentence with which a recording is refused."""
    with pytest.raises(InputError) as refusal:
        read_all(path)
    text = str(refusal.value)
    assert SENTENCE.fullmatch(text)
    assert path.name in text
    return text


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length (with its head of nine bytes) of every record outside of chunks."""
    at = len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        yield opcode, at, length + 9
        at += length + 9


def test_a_recording_cut_anywhere_names_recover(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    for size in (*range(8, len(whole), 1000), len(whole) - 1):
        path.write_bytes(whole[:size])
        assert "make it again from its source" in sentence(path), size
        with pytest.raises(InputError, match="make it again from its source"):
            read_frames(path)  # at once, not at the first frame


@pytest.mark.parametrize("opcode", sorted(Opcode, key=lambda opcode: opcode.value), ids=lambda opcode: opcode.name)
def test_a_flipped_bit_is_found_or_harmless(whole: bytes, tmp_path: Path, opcode: Opcode) -> None:
    path = tmp_path / "flipped.mcap"
    path.write_bytes(whole)
    expected = read_all(path)
    places = [(at, size) for found, at, size in records(whole) if found == opcode]
    if opcode in (Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.ATTACHMENT_INDEX):
        assert not places, "openvox writes none outside of chunks"
        return
    assert places
    found = 0
    for at, size in (places[0], places[-1]):
        for offset in sorted({0, 1, 8, 9, 9 + (size - 9) // 3, 9 + (size - 9) * 2 // 3, size - 1}):
            data = bytearray(whole)
            data[at + offset] ^= 0x10
            path.write_bytes(data)
            result = outcome(path)
            assert result in (expected, None)
            found += result is None
    assert found


def test_both_magics_are_checked(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\0" + whole[1:])
    assert "is no MCAP file" in sentence(path)
    path.write_bytes(whole[:-1] + b"\0")
    assert "is cut off" in sentence(path)


def test_no_file_an_empty_file_a_folder_and_an_unfinished_file(whole: bytes, tmp_path: Path) -> None:
    assert "there is no file" in sentence(tmp_path / "none.mcap")
    (tmp_path / "empty.mcap").touch()
    assert "is no MCAP file" in sentence(tmp_path / "empty.mcap")
    (tmp_path / "folder.mcap").mkdir()
    assert "could not be read: Is a directory" in sentence(tmp_path / "folder.mcap")
    (tmp_path / "a.mcap.partial").write_bytes(whole[:20])
    assert "has no metadata record openvox.recording.begin" in sentence(tmp_path / "a.mcap.partial")


# Whole MCAP files that are no whole recordings


Edit = Callable[[str, Any], Any]


def rewritten(whole: bytes, path: Path, edit: Edit, metadata: Callable[[dict[str, str]], Any] = dict) -> Path:
    """The recording written again by the stock writer, each message as `edit` makes it (None: left out)."""
    source = path.with_suffix(".source")
    source.write_bytes(whole)
    with source.open("rb") as file, path.open("wb") as out:
        reader, writer = make_reader(file), Writer(out)
        writer.start()
        channels: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            changed = edit(channel.topic, message)
            if changed is None:
                continue
            if channel.topic not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            writer.add_message(
                channels[channel.topic], changed.log_time, changed.data, changed.publish_time, changed.sequence
            )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, metadata(record.metadata) if record.name == METADATA else record.metadata)
        writer.finish()
    return path


def without(*topics: str) -> Edit:
    return lambda topic, message: None if topic in topics else message


def changing(topic: str, message_class: Any, change: Callable[[Any], None]) -> Edit:
    """Changes the messages of a topic from sequence 5 on."""

    def edit(found: str, message: Any) -> Any:
        if found == topic and message.sequence >= 5:
            decoded = message_class.FromString(message.data)
            change(decoded)
            message.data = decoded.SerializeToString()
        return message

    return edit


def bytes_of(topic: str, change: Callable[[bytes], bytes]) -> Edit:
    def edit(found: str, message: Any) -> Any:
        if found == topic:
            message.data = change(message.data)
        return message

    return edit


def test_rewritten_unchanged_it_reads(whole: bytes, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "a.mcap", without())
    assert [frame.index for frame in read_frames(path)] == [0, 5, 10, 15]


def test_colour_and_truth_may_be_missing(whole: bytes, tmp_path: Path) -> None:
    edit = without("/camera/color", "/camera/color/calibration", "/truth/instances", "/truth/categories")
    frames = list(read_frames(rewritten(whole, tmp_path / "a.mcap", edit)))
    assert [(frame.color, frame.truth_instances, frame.rig.registered) for frame in frames] == [(b"", None, True)] * 4


@pytest.mark.parametrize("topic", ["/camera/depth", "/camera/depth/calibration", "/tf"])
def test_depth_its_calibration_and_poses_may_not(whole: bytes, tmp_path: Path, topic: str) -> None:
    assert f"has no topic {topic}" in sentence(rewritten(whole, tmp_path / "a.mcap", without(topic)))


def test_a_message_missing_in_one_frame_is_named(whole: bytes, tmp_path: Path) -> None:
    def edit(topic: str, message: Any) -> Any:
        return None if (topic, message.sequence) == ("/camera/depth", 10) else message

    assert "frame 10: there is no message on /camera/depth" in sentence(rewritten(whole, tmp_path / "a.mcap", edit))


def test_a_missing_frame_is_missed(whole: bytes, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "a.mcap", lambda _, message: None if message.sequence == 5 else message)
    assert "holds 3 frames, its metadata say 4" in sentence(path)


def set_nan(message: Any) -> None:
    message.transforms[0].translation.y = float("nan")


def set_no_rotation(message: Any) -> None:
    message.transforms[0].rotation.w = 3.0


def set_other_frames(message: Any) -> None:
    message.transforms[0].child_frame_id = "base_link"


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (changing("/tf", FrameTransforms, set_nan), r"frame 5, /tf: pose holds a number that is not finite"),
        (changing("/tf", FrameTransforms, set_no_rotation), r"frame 5, /tf: pose quaternion has length"),
        (changing("/tf", FrameTransforms, set_other_frames), r"frame 5, /tf: there is no transform of camera_depth"),
        (
            changing("/camera/depth/calibration", CameraCalibration, lambda m: setattr(m, "width", 31)),
            r"frame 5: depth image is 32x24, its camera 31x24",
        ),
        (
            changing("/camera/depth/calibration", CameraCalibration, lambda m: m.D.extend([0.1, 0.2])),
            r"frame 5, /camera/depth/calibration: calibration has 9 numbers in K and distortion \[0.1, 0.2\]",
        ),
        (
            changing("/camera/color/calibration", CameraCalibration, lambda m: setattr(m, "height", 25)),
            r"frame 5: (colour is a jpeg of 32x24; its camera says jpeg of 32x25|truth instances image is 32x24)",
        ),
        (
            changing("/truth/instances", RawImage, lambda m: setattr(m, "encoding", "mono8")),
            r"frame 5, /truth/instances: ids are 'mono8'",
        ),
        (
            bytes_of("/camera/depth", lambda d: d.replace(b"16UC1", b"32FC1")),
            r"frame 0, /camera/depth: depth is '32FC1'",
        ),
        (bytes_of("/camera/depth", lambda d: b"\0\0" + d[2:]), r"frame 0, /camera/depth: the CDR header is 00000000"),
        (bytes_of("/camera/depth", lambda d: d[:-2]), r"frame 0, /camera/depth: depth of 32x24 pixels has rows of 64"),
        (bytes_of("/camera/depth", lambda d: d[:30]), r"frame 0, /camera/depth: "),
        (bytes_of("/camera/color", lambda d: d[:40]), r"frame 0, /camera/color: "),
        (bytes_of("/tf", lambda _: b"\xff\xff\xff"), r"frame 0, /tf: "),
    ],
)
def test_what_a_message_holds_wrong_is_said_with_frame_and_topic(
    whole: bytes, tmp_path: Path, edit: Edit, expected: str
) -> None:
    assert re.search(expected, sentence(rewritten(whole, tmp_path / "a.mcap", edit)))


def test_stamps_and_numbers_must_rise(whole: bytes, tmp_path: Path) -> None:
    def stamp(_: str, message: Any) -> Any:
        message.log_time = min(message.log_time, 1_500_000_000)
        return message

    def number(_: str, message: Any) -> Any:
        message.sequence = {10: 3}.get(message.sequence, message.sequence)
        return message

    def torn(topic: str, message: Any) -> Any:
        message.log_time += topic == "/tf"
        return message

    path = tmp_path / "a.mcap"
    assert "frame 10 with stamp 1500000000 ns follows frame 5" in sentence(rewritten(whole, path, stamp))
    assert "frame 3 with stamp 2000000000 ns follows frame 5" in sentence(rewritten(whole, path, number))
    assert "comes twice or with another stamp" in sentence(rewritten(whole, path, torn))


def test_a_newer_format_is_refused_with_its_version(whole: bytes, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "a.mcap", without(), lambda record: record | {"format_version": "2"})
    assert "has format version 2 of openvox.recording; this openvox reads up to 1" in sentence(path)


def test_changed_metadata_are_found(whole: bytes, tmp_path: Path) -> None:
    path = rewritten(whole, tmp_path / "a.mcap", without(), lambda record: record | {"depth_unit": "m"})
    assert "the checksum of metadata openvox.recording is wrong" in sentence(path)


def test_another_mcap_file_is_no_recording(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as out:
        writer = Writer(out)
        writer.start()
        writer.finish()
    assert "has no metadata record openvox.recording" in sentence(tmp_path / "a.mcap")


# Hostile lengths: nothing is allocated that the file does not hold


@contextmanager
def little_memory() -> Iterator[None]:
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


def with_first_chunk(whole: bytes, change: Callable[[bytearray], None]) -> bytes:
    """The file with the content of its first chunk record changed."""
    data = bytearray(whole)
    at, size = next((at, size) for opcode, at, size in records(whole) if opcode == Opcode.CHUNK)
    content = data[at + 9 : at + size]
    change(content)
    data[at + 9 : at + size] = content
    return bytes(data)


def state_huge_size(content: bytearray) -> None:
    struct.pack_into("<Q", content, 16, 1 << 40)


def state_huge_name(content: bytearray) -> None:
    struct.pack_into("<I", content, 28, (1 << 32) - 1)


def pack_a_bomb(content: bytearray) -> None:
    """Packed data whose own header states 2**40 bytes."""
    packed = zstandard.ZstdCompressor().compress(b"x")
    bomb = packed[:4] + bytes([0xE0]) + struct.pack("<Q", 1 << 40) + packed[6:]
    assert zstandard.frame_content_size(bomb) == 1 << 40
    content[44 : 44 + len(bomb)] = bomb


@pytest.mark.parametrize("change", [state_huge_size, state_huge_name, pack_a_bomb])
def test_hostile_chunks_allocate_nothing(whole: bytes, tmp_path: Path, change: Callable[[bytearray], None]) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(with_first_chunk(whole, change))
    with little_memory():
        sentence(path)


def test_hostile_record_lengths_allocate_nothing(whole: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for _, at, _ in records(whole):
        data = bytearray(whole)
        struct.pack_into("<Q", data, at + 1, 1 << 62)
        path.write_bytes(data)
        with little_memory():
            assert "damaged" in sentence(path)
