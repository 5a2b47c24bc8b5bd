"""What can be read of a broken MCAP file of ours: every chunk whose CRC is right, and where something is missing.

Nothing that the file says is believed before a checksum vouches for it: lengths are held against the file, and after
bytes that are no record the next chunk is found by the look of its head.
"""

from __future__ import annotations

import mmap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from openvox.core.errors import InputError
from openvox.formats.mcap_io import (
    BROKEN,
    CHUNK,
    MAGIC,
    MAX_RECORD,
    MESSAGE,
    RECORD,
    Message,
    Topic,
    checksum,
    chunk_records,
    read_channels,
    stream,
    topic_of,
)

_PACKED = b"\x04\0\0\0zstd"
"""How the head of a chunk of ours ends: the name of its packing, and before it the name's length."""
_HEAD = RECORD.size + CHUNK.size - 4
"""Bytes of a chunk record before _PACKED."""
_LAST_OPCODE = 15


@dataclass(frozen=True, slots=True)
class Gap:
    """Something is missing here, and why."""

    reason: str


@dataclass(frozen=True, eq=False)
class Salvage:
    """What a file still has. `pieces`: offset and length of each whole chunk, and the gaps, in file order."""

    path: Path
    pieces: tuple[tuple[int, int] | Gap, ...]
    topics: Mapping[int, Topic]
    """By the number of the channel."""
    metadata: Mapping[str, Mapping[str, str]]
    """Those whose checksum is right."""

    def messages(self) -> Iterator[Message | Gap]:
        """The messages of the whole chunks in file order, with the gaps between them. Raises InputError."""
        with _mapped(self.path) as data:
            for piece in self.pieces:
                if isinstance(piece, Gap):
                    yield piece
                else:
                    yield from self._messages(piece[0], data[piece[0] : sum(piece)])

    def _messages(self, offset: int, content: bytes) -> Iterator[Message | Gap]:
        nameless = False
        for opcode, body in chunk_records(self.path, offset, content):
            if opcode == Opcode.MESSAGE:
                channel, sequence, log_time, _ = MESSAGE.unpack_from(body)
                if channel in self.topics:
                    yield Message(self.topics[channel].name, sequence, log_time, body[MESSAGE.size :])
                else:
                    nameless = True
        if nameless:
            yield Gap("the chunk that names its topic is lost")


def salvage(path: Path) -> Salvage:
    """Looks through a file, at each chunk once. Raises InputError for one that has no whole chunk."""
    found = _Findings(path)
    with _mapped(path) as data:
        found.look_through(data)
    if all(isinstance(piece, Gap) for piece in found.pieces):
        raise InputError(f"{path} has no whole chunk of an MCAP file that openvox wrote; there is nothing to save")
    topics = {number: topic_of(path, channel, found.schemas) for number, channel in found.channels.items()}
    with suppress(InputError):  # only a file with a whole end has them there, and then a CRC vouches for them
        topics = {**read_channels(path)}
    return Salvage(path, tuple(found.pieces), topics, found.metadata)


@contextmanager
def _mapped(path: Path) -> Iterator[mmap.mmap]:
    """The file's bytes, read by the system as they are looked at."""
    try:
        if path.stat().st_size < len(MAGIC):
            raise InputError(f"{path} has {path.stat().st_size} bytes; there is nothing to save")
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data
    except (OSError, ValueError) as error:
        raise InputError(f"{path} could not be read: {getattr(error, 'strerror', None) or error}") from error


@dataclass
class _Findings:
    """What was found so far."""

    path: Path
    pieces: list[tuple[int, int] | Gap] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)

    def look_through(self, data: mmap.mmap) -> None:
        """Record by record; where there is none, on at the next chunk."""
        at, chunk, end = len(MAGIC), 0, len(data)
        while at < end:
            opcode, length = _record_at(data, at)
            after = at + RECORD.size + length
            chunk = _next_chunk(data, at + 1) if chunk <= at else chunk
            if opcode == Opcode.CHUNK and self._is_whole(at, data[at + RECORD.size : after]):
                self.pieces.append((at + RECORD.size, length))
                at = after
            elif opcode and after <= chunk:  # what reaches over the next chunk has a wrong length
                if opcode == Opcode.DATA_END and chunk == end:
                    return
                self._take(opcode, data[at + RECORD.size : after])
                at = after
            else:
                self.pieces.append(Gap("damaged bytes" if chunk < end else "the file is cut off or damaged"))
                at = chunk
        self.pieces.append(Gap("the file was never finished"))

    def _is_whole(self, at: int, content: bytes) -> bool:
        """True for a chunk whose CRC is right and whose records can be read; what names its topics is kept."""
        try:
            for opcode, body in chunk_records(self.path, at, content):
                if opcode == Opcode.SCHEMA:
                    schema = Schema.read(stream(bytes(body)))
                    self.schemas.setdefault(schema.id, schema)
                elif opcode == Opcode.CHANNEL:
                    channel = Channel.read(stream(bytes(body)))
                    self.channels.setdefault(channel.id, channel)
                elif opcode == Opcode.MESSAGE:
                    MESSAGE.unpack_from(body)
        except (InputError, *BROKEN):
            return False
        return True

    def _take(self, opcode: int, content: bytes) -> None:
        """A record outside of the chunks, or one that should have been a chunk."""
        if opcode == Opcode.CHUNK or content.startswith(_PACKED, _HEAD - RECORD.size):
            self.pieces.append(Gap("a damaged chunk"))
        elif opcode == Opcode.METADATA:
            with suppress(*BROKEN):
                found = cast(Metadata, Metadata.read(stream(content)))
                record = dict(found.metadata)
                if record.pop("check", "") == checksum(record):
                    self.metadata[found.name] = record


def _record_at(data: mmap.mmap, at: int) -> tuple[int, int]:
    """Opcode and length of a record; 0 and 0 if there cannot be one."""
    if at + RECORD.size > len(data):
        return 0, 0
    opcode, length = RECORD.unpack_from(data, at)
    if not 0 < opcode <= _LAST_OPCODE or length > min(MAX_RECORD, len(data) - at - RECORD.size):
        return 0, 0
    return opcode, length


def _next_chunk(data: mmap.mmap, start: int) -> int:
    """Where, from start on, the next bytes stand that look like the head of a chunk; the file's end if nowhere."""
    found = data.find(_PACKED, start + _HEAD)
    while found >= 0 and _record_at(data, found - _HEAD)[0] != Opcode.CHUNK:  # an index names the packing, too
        found = data.find(_PACKED, found + 1)
    return len(data) if found < 0 else found - _HEAD
