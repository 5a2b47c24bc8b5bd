"""Chunks of absurd sizes in MCAP files of other robots."""

import struct
from pathlib import Path

import pytest
import zstandard

from openvox.core.errors import InputError
from openvox.formats.foxglove_log import foxglove_topics
from openvox.formats.mcap_io import CHUNK

MAGIC = b"\x89MCAP0\r\n"


def _file(path: Path, stated: int, packed: bytes) -> Path:
    body = CHUNK.pack(0, 0, stated, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
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
