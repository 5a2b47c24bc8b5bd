"""MCAP files of any robot in Foxglove's schemas (protobuf), as pictures, calibrations and transforms."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from io import SEEK_END
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import zstandard
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader

from openvox.core.errors import InputError
from openvox.core.types import Pose
from openvox.formats.mcap_io import BROKEN, CHUNK, MAX_RECORD, RECORD
from openvox.formats.robot_log import Calibration, Item, Picture, TopicKind, Transform

LZ4_GROWTH, PIECE = 255, 1 << 22
"""Times that LZ4 data can grow at most; bytes that are unpacked at a time to see how much they are."""
KINDS: Mapping[str, TopicKind] = {
    "foxglove.CompressedImage": "image",
    "foxglove.RawImage": "image",
    "foxglove.CameraCalibration": "calibration",
    "foxglove.FrameTransform": "transforms",
    "foxglove.FrameTransforms": "transforms",
    "foxglove.PoseInFrame": "pose",
}


def foxglove_topics(path: Path) -> dict[str, tuple[str, str]]:
    """Schema and message encoding of every topic. Raises InputError."""
    with _reader(path) as reader:
        summary = reader.get_summary()
        if summary is None:
            raise InputError(f"{path} has no summary; is it whole?")
        return {
            channel.topic: (schema.name, channel.message_encoding)
            for channel in summary.channels.values()
            if (schema := summary.schemas.get(channel.schema_id)) is not None
        }


def messages(
    path: Path, topics: Collection[str], others: Callable[[str, str, bytes], Item] | None = None
) -> Iterator[tuple[int, str, Item]]:
    """(log time, topic, item) in the order of logging. others: decodes messages that are no protobuf, by their topic
    and schema. Raises InputError."""
    with _reader(path) as reader:
        for schema, channel, message in reader.iter_messages(topics=list(topics)):
            if channel.message_encoding == "protobuf" and schema.name in KINDS:
                yield message.log_time, channel.topic, item(channel.topic, schema.name, message.data)
            elif others is not None:
                yield message.log_time, channel.topic, others(channel.topic, schema.name, message.data)


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    """The library's reader, with every CRC checked; what broken bytes raise is one sentence."""
    try:
        with path.open("rb") as file:
            chunks = _check_chunks(path, file)
            reader = SeekingReader(file, validate_crcs=True, record_size_limit=MAX_RECORD)
            _check_index(path, reader, chunks)
            yield reader
    except (InputError, GeneratorExit, KeyboardInterrupt):
        raise
    except OSError as error:
        raise InputError(f"{path} could not be read: {error.strerror or error}") from error
    except (*BROKEN, DecodeError, ValueError, KeyError, RuntimeError, EOFError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path} could not be read as MCAP ({text:.300}); is it whole?") from error


def _check_chunks(path: Path, file: BinaryIO) -> set[int]:
    """Where chunks begin. Raises InputError for one that would unpack to more than MAX_RECORD: the library allocates
    what is stated, or as much as comes."""
    end = file.seek(0, SEEK_END)
    offset = file.seek(8)
    chunks = set()
    while offset + RECORD.size <= end:
        file.seek(offset)
        opcode, length = RECORD.unpack(file.read(RECORD.size))
        if opcode == Opcode.CHUNK:
            _check_chunk(path, offset, file, min(length, end - file.tell()))
            chunks.add(offset)
        offset += RECORD.size + length
    file.seek(0)
    return chunks


def _check_chunk(path: Path, offset: int, file: BinaryIO, length: int) -> None:
    head = file.read(min(length, 256))
    _, _, size, _, named = CHUNK.unpack_from(head)
    kind, begin = head[CHUNK.size : CHUNK.size + named], CHUNK.size + named + 8
    sizes = [size]
    if kind == b"zstd":
        sizes.append(zstandard.frame_content_size(head[begin:]))
    elif kind == b"lz4" and LZ4_GROWTH * length > MAX_RECORD:
        file.seek(offset + RECORD.size + begin)
        sizes.append(_lz4_size(file.read(length - begin)))
    if max(sizes) > MAX_RECORD:
        raise InputError(
            f"{path}: the chunk at byte {offset} states {max(sizes)} bytes unpacked; at most {MAX_RECORD} are read"
        )


def _lz4_size(data: bytes) -> int:
    """Bytes that it unpacks to, as far as it is allowed to: nothing obliges an LZ4 frame to state them."""
    unpacker = lz4.frame.LZ4FrameDecompressor()
    size = len(unpacker.decompress(data, max_length=PIECE))
    while not (unpacker.eof or unpacker.needs_input) and size <= MAX_RECORD:
        size += len(unpacker.decompress(b"", max_length=PIECE))
    return size


def _check_index(path: Path, reader: SeekingReader, chunks: Collection[int]) -> None:
    """Raises InputError where the index says that a chunk begins where none was found, and checked."""
    summary = reader.get_summary()
    for index in summary.chunk_indexes if summary else ():
        if index.chunk_start_offset not in chunks:
            raise InputError(
                f"{path}: its index says that a chunk begins at byte {index.chunk_start_offset}, where none does; "
                "write the index anew (mcap recover)"
            )


def item(topic: str, schema: str, data: bytes) -> Item:
    """A protobuf message of one of the KINDS. Raises DecodeError."""
    if schema == "foxglove.CompressedImage":
        image = CompressedImage.FromString(data)
        return Picture(_stamp(image), image.frame_id, "compressed", image.data)
    if schema == "foxglove.RawImage":
        raw = RawImage.FromString(data)
        return Picture(_stamp(raw), raw.frame_id, raw.encoding, raw.data, raw.width, raw.height, raw.step)
    if schema == "foxglove.CameraCalibration":
        c = CameraCalibration.FromString(data)
        return Calibration(c.frame_id, c.width, c.height, tuple(c.K), tuple(c.D), c.distortion_model, tuple(c.P))
    if schema == "foxglove.FrameTransforms":
        return tuple(one for part in FrameTransforms.FromString(data).transforms for one in _transform(part))
    if schema == "foxglove.FrameTransform":
        return _transform(FrameTransform.FromString(data))
    pose = PoseInFrame.FromString(data)
    return _pose(_stamp(pose), pose.frame_id, topic, pose.pose.position, pose.pose.orientation)


def _transform(item: Any) -> tuple[Transform, ...]:
    return _pose(_stamp(item), item.parent_frame_id, item.child_frame_id, item.translation, item.rotation)


def _pose(stamp: int, parent: str, child: str, t: Any, q: Any) -> tuple[Transform, ...]:
    """One transform; none for numbers that are no pose."""
    try:
        pose = Pose((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))
    except InputError:
        return ()
    return (Transform(stamp, parent.lstrip("/"), child.lstrip("/"), pose),)


def _stamp(message: Any) -> int:
    return int(message.timestamp.seconds) * 10**9 + int(message.timestamp.nanos)
