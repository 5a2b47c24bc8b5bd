"""A file appears complete or not at all, and what stood there before survives every failure."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from openvox.core.errors import InputError, OutputError
from openvox.formats.atomic import only_writer, partial_file


def write(path: Path, text: str) -> None:
    with partial_file(path) as partial:
        partial.write_text(text)


def test_the_file_appears_when_the_block_ends_and_not_before(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with partial_file(path) as partial:
        partial.write_text("new")
        assert partial == tmp_path / "a.txt.partial"
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_an_older_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    write(path, "new")
    assert path.read_text() == "new"


def write_half_and_raise(partial: Path, error: BaseException) -> None:
    partial.write_text("half")
    raise error


@pytest.mark.parametrize("error", [InputError("bad frame"), KeyboardInterrupt(), ZeroDivisionError()])
def test_any_exception_leaves_the_older_file_and_no_partial_one(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(type(error)), partial_file(path) as partial:
        write_half_and_raise(partial, error)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here to play the full disk")
def test_a_full_disk_is_one_sentence_and_the_older_file_survives(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    (tmp_path / "a.txt.partial").symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"a\.txt could not be written \(No space left on device\)"):
        write(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No such file or directory"):
        write(tmp_path / "nowhere" / "a.txt", "new")


def test_a_folder_in_the_place_of_the_file_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputError, match="is a folder"), partial_file(tmp_path / "a"):
        pytest.fail("the block must not run")


def test_a_device_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OutputError, match="is a device or a pipe, which would be replaced"):
        write(tmp_path / "pipe", "new")
    assert (tmp_path / "pipe").is_fifo()


def test_a_second_writer_is_told_so_and_nothing_is_left(tmp_path: Path) -> None:
    with only_writer(tmp_path / "a.txt"):
        busy = pytest.raises(OutputError, match=r"a\.txt is being written by another openvox")
        with busy, only_writer(tmp_path / "a.txt"):
            pytest.fail("the block must not run")
        with only_writer(tmp_path / "b.txt"):
            pass
    with only_writer(tmp_path / "a.txt"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_the_lock_of_a_killed_writer_keeps_nobody_out(tmp_path: Path) -> None:
    (tmp_path / ".a.txt.lock").touch()
    with only_writer(tmp_path / "a.txt"):
        pass
    with pytest.raises(OutputError, match="No such file or directory"), only_writer(tmp_path / "nowhere" / "a.txt"):
        pytest.fail("the block must not run")
