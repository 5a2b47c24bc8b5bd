"""MCAP as openvox writes and reads it: chunks closed early, every CRC checked, bounded memory, errors as sentences.

The reader is our own walk over the records: every length is held against the file before anything is allocated, and
only what the summary's CRC vouches for is believed.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
import zlib
from array import array
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self, cast

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Metadata, MetadataIndex, Schema
from mcap.writer import CompressionType, Writer

from openvox import __version__
from openvox.core.digest import canonical_json
from openvox.core.errors import InputError
from openvox.formats.atomic import partial_file

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 1 << 20
CHUNK_NS = 1_000_000_000
MAX_RECORD = 1 << 28
"""Bytes that a record may have, compressed or not: a length beyond it is damage, not data."""
CURE = "copy it anew, make it again from its source, or save what is whole with openvox recover"

RECORD = struct.Struct("<BQ")
CHUNK = struct.Struct("<QQQII")
MESSAGE = struct.Struct("<HIQQ")
_FOOTER = struct.Struct("<BQQQI")
BROKEN = (McapError, zstandard.ZstdError, struct.error, UnicodeDecodeError, OverflowError, MemoryError)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic and how its messages are to be read."""

    name: str
    message_encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


@dataclass(frozen=True, slots=True)
class Message:
    """One message; `data` is a view into its chunk."""

    topic: str
    sequence: int
    log_time: int
    data: memoryview


class McapWriter:
    """Writes one MCAP file, complete or not at all. A context manager; the same calls give the same bytes.

    resumable: Ctrl-C leaves NAME.partial. live: so does every error after the first message, and a chunk is closed
    after half a second, so that a crash loses less than the last one."""

    def __init__(self, path: Path, *, resumable: bool = False, live: bool = False):
        self.path = path
        self._resumable, self._live = resumable, live
        self._channels: dict[str, int] = {}
        self._chunk_start = self._chunk_bytes = 0

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            partial = stack.enter_context(partial_file(self.path, keep=self._keeps))
            file = stack.enter_context(partial.open("wb"))
            # The library's own limit is out of reach, so that chunks are closed here, by bytes and by time.
            self._writer = Writer(file, chunk_size=MAX_RECORD, compression=CompressionType.ZSTD, enable_data_crcs=True)
            self._writer.start(library=f"openvox {__version__}")
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            if self._keeps(error):
                with suppress(OSError):
                    self._close_chunk()
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            self._writer.finish()  # type: ignore[no-untyped-call]

    def add(self, topic: Topic, sequence: int, log_time: int, data: bytes) -> None:
        """One message of a frame: its number and its stamp in nanoseconds. Neither may fall from call to call."""
        if len(data) > MAX_RECORD // 2:
            raise InputError(
                f"{self.path}, frame {sequence}: a message of {len(data)} bytes for {topic.name}; "
                f"at most {MAX_RECORD // 2} fit"
            )
        self.pass_time(log_time)
        if not self._chunk_bytes:
            self._chunk_start = log_time
        self._writer.add_message(self._channel(topic), log_time, data, log_time, sequence)
        self._chunk_bytes += RECORD.size + MESSAGE.size + len(data)
        if self._chunk_bytes >= CHUNK_BYTES:
            self._close_chunk()

    def pass_time(self, log_time: int) -> None:
        """Closes the chunk if it began long before that time, though nothing may be added then."""
        if self._chunk_bytes and log_time - self._chunk_start >= (CHUNK_NS // 2 if self._live else CHUNK_NS):
            self._close_chunk()

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """A record of names and texts, sealed with a checksum of its own: MCAP gives metadata none."""
        self._close_chunk()
        self._writer.add_metadata(name, {**record, "check": checksum(record)})
        self._writer.flush()  # type: ignore[no-untyped-call]

    def _keeps(self, error: BaseException) -> bool:
        return bool(self._channels) and (self._live or (self._resumable and isinstance(error, KeyboardInterrupt)))

    def _channel(self, topic: Topic) -> int:
        if topic.name not in self._channels:
            schema = self._writer.register_schema(topic.schema_name, topic.schema_encoding, topic.schema)
            self._channels[topic.name] = self._writer.register_channel(topic.name, topic.message_encoding, schema)
        return self._channels[topic.name]

    def _close_chunk(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._chunk_bytes = 0


def read_metadata(path: Path, name: str, *, newest: int) -> dict[str, str]:
    """The metadata record of that name. newest: the highest `format_version` that the caller can read.

    Raises InputError if the file is damaged or unfinished, has no such record or one of a newer format."""
    with _opened(path) as file:
        summary = _summary(path, file)
        if name not in summary.metadata:
            found = ", ".join(sorted(summary.metadata)) or "none"
            raise InputError(f"{path} has no metadata record {name}, so it is no file of that kind (records: {found})")
        offset = summary.metadata[name]
        records = _Records(path, file, offset, summary.data_end)
        opcode, content = next(iter(records), (0, b""))
        if opcode != Opcode.METADATA:
            raise _damage(path, offset, "no metadata record stands where the summary says")
        record = cast(Metadata, Metadata.read(stream(content))).metadata
    version = record.get("format_version", "")
    if not version.isdecimal() or int(version) > newest:
        raise InputError(
            f"{path} has format version {version or 'none'} of {name}; this openvox reads up to {newest}: "
            "use a newer openvox"
        )
    if record.pop("check", "") != checksum(record):
        raise _damage(path, offset, f"the checksum of metadata {name} is wrong")
    return record


def read_topics(path: Path) -> dict[str, Topic]:
    """The topics of a complete file by name, from its summary. Raises InputError."""
    return {topic.name: topic for topic in read_channels(path).values()}


def read_channels(path: Path) -> Mapping[int, Topic]:
    """The topics of a complete file by the number of their channel, from its summary. Raises InputError."""
    with _opened(path) as file:
        return _summary(path, file).topics


def read_messages(path: Path, topics: Collection[str], *, from_sequence: int = 0) -> Iterator[Message]:
    """The messages of some topics, in file order, with `sequence` >= from_sequence; chunks before it are not read.

    Every chunk's CRC is checked, and at the end that of the whole data section if all of it was read.
    Raises InputError at the first damage."""
    with _opened(path) as file:
        summary = _summary(path, file)
        names = {number: topic.name for number, topic in summary.topics.items()}
        start = _chunk_before(path, file, summary, from_sequence) if from_sequence > 0 else 0
        records = _Records(path, file, start, summary.data_end)
        for opcode, content in records:
            if opcode == Opcode.CHUNK:
                for message in _chunk_messages(path, records.offset, content, names):
                    if message.topic in topics and message.sequence >= from_sequence:
                        yield message
            elif opcode == Opcode.MESSAGE:
                raise _damage(path, records.offset, "a message stands outside of the chunks")
            elif opcode == Opcode.DATA_END:
                (expected,) = struct.unpack_from("<I", content)
                if start == 0 and expected not in (0, records.crc_before):
                    raise _damage(path, records.offset, "the CRC of the data section is wrong")
                return
        raise _damage(path, summary.data_end, "the data section has no end")


@dataclass(frozen=True, slots=True)
class _Summary:
    topics: Mapping[int, Topic]
    chunks: array[int]
    """Offset of every chunk, ascending."""
    metadata: Mapping[str, int]
    """Offset of every metadata record by name."""
    data_end: int
    """Where the data section ends and the summary begins."""


class _Records:
    """The records between two offsets of a file, as (opcode, content), none longer than what is there."""

    def __init__(self, path: Path, file: BinaryIO, start: int, end: int):
        self.path, self._file, self._next, self._end = path, file, start, end
        self.offset = start
        """Of the record yielded last."""
        self.crc = self.crc_before = 0
        """CRC of all bytes so far, with and without the record yielded last."""

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        self._file.seek(self._next)
        if self._next == 0:
            self.crc = zlib.crc32(self._file.read(len(MAGIC)))
            self._next = len(MAGIC)
        while self._next < self._end:
            self.offset, self.crc_before = self._next, self.crc
            head = self._file.read(RECORD.size)
            opcode, length = RECORD.unpack(head)
            if length > min(MAX_RECORD, self._end - self.offset - RECORD.size):
                raise _damage(self.path, self.offset, f"a record of {length} bytes cannot be")
            content = self._file.read(length)
            if len(content) != length:
                raise _damage(self.path, self.offset, "the file ends within a record")
            self.crc = zlib.crc32(content, zlib.crc32(head, self.crc))
            self._next = self.offset + RECORD.size + length
            yield opcode, content


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """The file, and everything that reading broken bytes can raise as one InputError."""
    if path.suffix == ".partial":
        raise InputError(
            f"{path} is unfinished (being written, or left by a crash): save what is whole with openvox recover"
        )
    try:
        with path.open("rb") as file:
            yield file
    except BROKEN as error:
        raise InputError(f"{path} is damaged ({type(error).__name__}: {error}): {CURE}") from error
    except OSError as error:
        raise InputError(f"{path} could not be read: {error.strerror or error}") from error


def _damage(path: Path, offset: int, what: str) -> InputError:
    return InputError(f"{path} is damaged at byte {offset}: {what}; {CURE}")


def _summary(path: Path, file: BinaryIO) -> _Summary:
    """What stands after the data, vouched for by its CRC."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        raise InputError(f"{path} is no MCAP file: it does not begin as one")
    footer_at = size - len(MAGIC) - _FOOTER.size
    file.seek(max(footer_at, 0))
    tail = file.read()
    if footer_at < len(MAGIC) or tail[-len(MAGIC) :] != MAGIC:
        raise InputError(f"{path} is cut off: its end is missing; {CURE}")
    opcode, length, start, _, expected = _FOOTER.unpack_from(tail)
    if opcode != Opcode.FOOTER or length != _FOOTER.size - RECORD.size or not len(MAGIC) <= start <= footer_at:
        raise _damage(path, footer_at, "the footer is wrong")
    records = _Records(path, file, start, footer_at)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    chunks, metadata = array("Q"), dict[str, int]()
    for opcode, content in records:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream(content))
            schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream(content))
            channels[channel.id] = channel
        elif opcode == Opcode.CHUNK_INDEX:
            chunks.append(ChunkIndex.read(stream(content)).chunk_start_offset)
        elif opcode == Opcode.METADATA_INDEX:
            index = MetadataIndex.read(stream(content))
            metadata[index.name] = index.offset
    # The CRC also covers the footer up to the CRC itself.
    if zlib.crc32(tail[: _FOOTER.size - 4], records.crc) != expected:
        raise _damage(path, start, "the CRC of the summary is wrong")
    return _Summary(
        {number: topic_of(path, channel, schemas) for number, channel in channels.items()}, chunks, metadata, start
    )


def topic_of(path: Path, channel: Channel, schemas: Mapping[int, Schema]) -> Topic:
    """The topic of a channel record."""
    schema = schemas.get(channel.schema_id)
    if schema is None:
        return Topic(channel.topic, channel.message_encoding, "", "", b"")
    return Topic(channel.topic, channel.message_encoding, schema.name, schema.encoding, schema.data)


def _chunk_messages(path: Path, offset: int, content: bytes, names: Mapping[int, str]) -> Iterator[Message]:
    """The messages of a chunk record, after its CRC was found right."""
    for opcode, body in chunk_records(path, offset, content):
        if opcode == Opcode.MESSAGE:
            channel, sequence, log_time, _ = MESSAGE.unpack_from(body)
            if channel not in names:
                raise _damage(path, offset, f"a message is of channel {channel}, which the summary lacks")
            yield Message(names[channel], sequence, log_time, body[MESSAGE.size :])


def chunk_records(path: Path, offset: int, content: bytes) -> Iterator[tuple[int, memoryview]]:
    """The records inside of a chunk record, as (opcode, content), after its CRC was found right.

    Raises InputError or one of BROKEN."""
    data = memoryview(_chunk_data(path, offset, content))
    at = 0
    while at < len(data):
        opcode, length = RECORD.unpack_from(data, at)
        body = data[at + RECORD.size : at + RECORD.size + length]
        if len(body) != length:
            raise _damage(path, offset, "a record reaches beyond its chunk")
        at += RECORD.size + length
        yield opcode, body


def _chunk_data(path: Path, offset: int, content: bytes) -> bytes:
    """Unpacked bytes of a chunk record, no more of them than it states."""
    _, _, size, crc, name_length = CHUNK.unpack_from(content)
    at = CHUNK.size + name_length
    compression = content[CHUNK.size : at]
    (length,) = struct.unpack_from("<Q", content, at)
    packed = memoryview(content)[at + 8 :]
    if length != len(packed) or size > MAX_RECORD:
        raise _damage(path, offset, f"a chunk states {length} bytes that unpack to {size}")
    if compression == b"zstd":
        # The packed data state a size of their own, which the library would allocate unasked.
        if zstandard.frame_content_size(packed) not in (size, -1):
            raise _damage(path, offset, "a chunk and its packed data state different sizes")
        data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    elif compression == b"":
        data = bytes(packed)
    else:
        raise InputError(f"{path}: chunks are packed with {compression!r}; openvox reads zstd")
    if len(data) != size or zlib.crc32(data) != crc:
        raise _damage(path, offset, "the CRC of a chunk is wrong")
    return data


def _chunk_before(path: Path, file: BinaryIO, summary: _Summary, sequence: int) -> int:
    """Offset of the last chunk that begins before that sequence (the frame's first messages may be in it); else 0."""
    place = bisect_left(summary.chunks, sequence, key=lambda offset: _first_sequence(path, file, summary, offset))
    return summary.chunks[place - 1] if place else 0


def _first_sequence(path: Path, file: BinaryIO, summary: _Summary, offset: int) -> int:
    """Sequence of a chunk's first message, without unpacking what follows."""
    content = next((content for opcode, content in _Records(path, file, offset, summary.data_end)), b"")
    named = CHUNK.unpack_from(content)[4]
    packed = io.BytesIO(content[CHUNK.size + named + 8 :])
    with closing(zstandard.ZstdDecompressor().stream_reader(packed) if named else packed) as data:
        while True:
            opcode, length = RECORD.unpack(data.read(RECORD.size))
            if opcode == Opcode.MESSAGE:
                return int(MESSAGE.unpack(data.read(MESSAGE.size))[1])
            if length > MAX_RECORD:
                raise _damage(path, offset, f"a record of {length} bytes cannot be")
            data.read(length)


def stream(content: bytes) -> ReadDataStream:
    """What the library's records are parsed from."""
    return ReadDataStream(io.BytesIO(content))


def checksum(record: Mapping[str, str]) -> str:
    """That of a metadata record, which keeps it as `check`."""
    return hashlib.sha256(canonical_json(dict(record))).hexdigest()
