"""Chunks of absurd sizes in MCAP files of other robots."""

import struct
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.reader import SeekingReader
from mcap.writer import CompressionType, Writer

from openvox.core.errors import InputError
from openvox.formats.foxglove_log import foxglove_topics
from openvox.formats.mcap_io import CHUNK

MAGIC = b"\x89MCAP0\r\n"


def _file(path: Path, stated: int, packed: bytes, kind: bytes = b"zstd") -> Path:
    body = CHUNK.pack(0, 0, stated, 0, len(kind)) + kind + struct.pack("<Q", len(packed)) + packed
    path.write_bytes(MAGIC + b"\x06" + struct.pack("<Q", len(body)) + body + MAGIC)
    return path


def test_a_chunk_that_states_an_absurd_size_is_one_sentence(tmp_path: Path) -> None:
    path = _file(tmp_path / "a.mcap", 1 << 40, zstandard.compress(b"x"))
    with pytest.raises(InputError, match=f"states {1 << 40} bytes unpacked"):
        foxglove_topics(path)


def test_packed_data_that_state_an_absurd_size_are_one_sentence(tmp_path: Path) -> None:
    bomb = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 1 << 40) + b"\x01\x00\x00"
    with pytest.raises(InputError, match=f"states {1 << 40} bytes unpacked"):
        foxglove_topics(_file(tmp_path / "b.mcap", 1, bomb))


def test_lz4_data_that_unpack_to_more_than_they_state_are_one_sentence(tmp_path: Path) -> None:
    zeros = bytes(1 << 20)
    packer = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    bomb = packer.begin() + b"".join(packer.compress(zeros) for _ in range(300)) + packer.flush()
    assert len(bomb) < 2 << 20
    with pytest.raises(InputError, match=r"the chunk at byte 8 states \d+ bytes unpacked; at most 268435456 are read"):
        foxglove_topics(_file(tmp_path / "c.mcap", 1, bomb, b"lz4"))


def test_an_index_that_points_into_something_else_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "d.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4)
        writer.start()
        channel = writer.register_channel("/a", "json", writer.register_schema("x", "jsonschema", b"{}"))
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    assert foxglove_topics(path) == {"/a": ("x", "json")}
    data = path.read_bytes()
    with path.open("rb") as file:
        (index,) = SeekingReader(file).get_summary().chunk_indexes
    start = struct.pack("<QQQ", 0, 0, index.chunk_start_offset)
    assert data.count(start) == 1
    path.write_bytes(data.replace(start, struct.pack("<QQQ", 0, 0, index.chunk_start_offset + 1)))
    with pytest.raises(InputError, match="its index says that a chunk begins at byte"):
        foxglove_topics(path)
