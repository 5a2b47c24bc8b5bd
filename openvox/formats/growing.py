"""MCAP files of ours that have no end yet: being written at this moment, or left behind by a crash as NAME.partial.

They are read from the beginning, record by record, as far as whole chunks go; every chunk's CRC is checked.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, cast

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from openvox.core.errors import InputError
from openvox.formats.mcap_io import (
    BROKEN,
    MAGIC,
    MAX_RECORD,
    MESSAGE,
    RECORD,
    Message,
    Topic,
    checksum,
    chunk_records,
    stream,
    topic_of,
)

PARTIAL = ".partial"
CURE = "save what is whole with openvox recover"
Wait = Callable[[], bool]
"""Called where a file ends before its end: True = look again, False = take it as it is."""


def is_unfinished(path: Path) -> bool:
    """True for a name that files have while they are being written."""
    return path.suffix == PARTIAL


def final_name(path: Path) -> Path:
    """The name that an unfinished file will get; any other path as it is."""
    return path.with_suffix("") if is_unfinished(path) else path


def finished_or_not(path: Path) -> Path:
    """The file of that name, or what there is of it so far where only that is there."""
    partial = path.with_name(path.name + PARTIAL)
    return partial if partial.exists() and not path.exists() else path


def growing_messages(path: Path, topics: Collection[str], wait: Wait = lambda: False) -> Iterator[Message]:
    """The messages of some topics in file order, up to the last whole chunk; `wait` decides what that is.

    Raises InputError for damage before it."""
    names: dict[int, str] = {}
    for kind, found in _contents(path, wait):
        if kind == Opcode.CHANNEL:
            number, topic = cast(tuple[int, Topic], found)
            names[number] = topic.name
        elif kind == Opcode.MESSAGE:
            channel, sequence, log_time, data = cast(tuple[int, int, int, memoryview], found)
            if names.get(channel) in topics:
                yield Message(names[channel], sequence, log_time, data)


def growing_topics(path: Path) -> dict[str, Topic]:
    """The topics of the whole chunks by name. Raises InputError."""
    found = (cast(tuple[int, Topic], item)[1] for kind, item in _contents(path) if kind == Opcode.CHANNEL)
    return {topic.name: topic for topic in found}


def growing_metadata(path: Path, name: str, *, newest: int, wait: Wait = lambda: False) -> dict[str, str]:
    """The metadata record of that name, which stands before the first message. Raises InputError."""
    with closing(_contents(path, wait)) as contents:
        for kind, found in contents:
            if kind == Opcode.METADATA and cast(Metadata, found).name == name:
                record = dict(cast(Metadata, found).metadata)
                return _checked(path, name, record, newest)
            if kind == Opcode.MESSAGE:
                break
    raise InputError(f"{path} has no metadata record {name} before its first message, so it is no file of that kind")


def _checked(path: Path, name: str, record: dict[str, str], newest: int) -> dict[str, str]:
    if record.pop("check", "") != checksum(record):
        raise InputError(f"{path} is damaged: the checksum of metadata {name} is wrong; {CURE}")
    version = record.get("format_version", "")
    if not version.isdecimal() or int(version) > newest:
        raise InputError(
            f"{path} has format version {version or 'none'} of {name}; this openvox reads up to {newest}: "
            "use a newer openvox"
        )
    return record


def _opened(path: Path) -> BinaryIO:
    """The file, under its final name where it got that since it was found."""
    try:
        return path.open("rb")
    except FileNotFoundError:
        if final_name(path) == path:
            raise
        return final_name(path).open("rb")


def _contents(path: Path, wait: Wait = lambda: False) -> Generator[tuple[int, object], None, None]:
    """Channels as (number, topic), metadata and messages as (channel, sequence, log time, data), in file order."""
    schemas: dict[int, Schema] = {}
    try:
        with _opened(path) as file:
            for offset, opcode, content in _records(path, file, wait):
                if opcode == Opcode.METADATA:
                    yield opcode, Metadata.read(stream(content))
                inner = chunk_records(path, offset, content) if opcode == Opcode.CHUNK else [(opcode, content)]
                for kind, body in inner:
                    if kind == Opcode.SCHEMA:
                        schema = Schema.read(stream(bytes(body)))
                        schemas[schema.id] = schema
                    elif kind == Opcode.CHANNEL:
                        channel = Channel.read(stream(bytes(body)))
                        yield kind, (channel.id, topic_of(path, channel, schemas))
                    elif kind == Opcode.MESSAGE and opcode == Opcode.CHUNK:
                        number, sequence, log_time, _ = MESSAGE.unpack_from(body)
                        yield kind, (number, sequence, log_time, memoryview(body)[MESSAGE.size :])
    except BROKEN as error:
        raise InputError(f"{path} is damaged ({type(error).__name__}: {error}): {CURE}") from error
    except OSError as error:
        raise InputError(f"{path} could not be read: {error.strerror or error}") from error


def _records(path: Path, file: BinaryIO, wait: Wait) -> Iterator[tuple[int, int, bytes]]:
    """(offset, opcode, content) of the records of the data section that are there with all their bytes."""
    magic = _read(file, len(MAGIC), wait)
    if magic is None:
        return
    if magic != MAGIC:
        raise InputError(f"{path} is no MCAP file: it does not begin as one")
    while (head := _read(file, RECORD.size, wait)) is not None:
        offset = file.tell() - RECORD.size
        opcode, length = RECORD.unpack(head)
        if not 0 < opcode < 0x80 or length > MAX_RECORD:
            raise InputError(f"{path} is damaged at byte {offset}: no record stands there; {CURE}")
        content = _read(file, length, wait)
        if content is None or opcode == Opcode.DATA_END:
            return
        yield offset, opcode, content


def _read(file: BinaryIO, size: int, wait: Wait) -> bytes | None:
    """So many bytes once they are there; None if they never will be."""
    start = file.tell()
    while os.fstat(file.fileno()).st_size < start + size:
        if not wait():
            return None
    file.seek(start)
    return file.read(size)


def whole_groups(groups: Iterator[Mapping[str, Message]]) -> Iterator[Mapping[str, Message]]:
    """The frames' messages, without those of a last frame that lacks topics which the one before has."""
    before: Mapping[str, Message] | None = None
    waiting: Mapping[str, Message] | None = None
    for group in groups:
        if waiting is not None:
            yield waiting
        before, waiting = waiting, group
    if waiting is not None and (before is None or before.keys() <= waiting.keys()):
        yield waiting
