"""Files that appear complete or not at all: written to NAME.partial, renamed when done."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from openvox.core.errors import OutputError


def never(error: BaseException) -> bool:
    """An unfinished file is of no use."""
    return False


@contextmanager
def partial_file(path: Path, *, keep: Callable[[BaseException], bool] = never) -> Iterator[Path]:
    """Yields NAME.partial to be written; it becomes `path`, replacing an older file, when the block ends well.

    On an exception the partial file is removed unless `keep` says that something can still be made of it, and what
    stood at `path` is left as it was. An OSError of the block is
    taken for one of writing: the block turns errors of its inputs into InputError itself. Raises OutputError.
    """
    if path.is_dir():
        raise OutputError(f"{path} is a folder; name a file to write")
    partial = path.with_name(path.name + ".partial")
    try:
        if path.exists() and not path.is_file():
            raise OutputError(f"{path} is a device or a pipe, which would be replaced; name a file to write")
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(partial, path)
    except BaseException as error:
        left = "nothing was left there"
        if keep(error):
            left = f"what there is of it stands in {partial.name}"
        else:
            _remove(partial)
        if isinstance(error, OSError):
            raise OutputError(
                f"{path} could not be written ({error.strerror or error}); {left}, an older file "
                "of that name is untouched: check the folder, its permissions and the space on the disk"
            ) from error
        raise


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Keeps other processes that ask for it from writing `path` meanwhile; one that was killed no longer does.

    Where the system or its disk knows no locks nothing is kept. Raises OutputError if another one is at it."""
    lock = path.with_name(f".{path.name}.lock")
    try:
        file = lock.open("ab")
    except OSError as error:
        raise OutputError(
            f"{path} could not be written ({error.strerror or error}): check the folder and its permissions"
        ) from error
    with file:
        if not _locked(file.fileno()):
            raise OutputError(f"{path} is being written by another openvox; wait until it is done, or stop it")
        try:
            yield
        finally:
            _remove(lock)


def _locked(descriptor: int) -> bool:
    """False if another process holds the lock of that file."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except (ImportError, OSError):  # another system, or a disk without locks
        return True
    return True


def check_not_input(out: Path, *inputs: Path | None) -> None:
    """Raises OutputError if `out` is one of the files that it is made from."""
    if any(path is not None and path.exists() and out.exists() and out.samefile(path) for path in inputs):
        raise OutputError(f"{out} would be overwritten by what is made from it; choose another name")


def check_writable(path: Path) -> None:
    """Before long work for it: raises OutputError where no file of this name could be made. Nothing is left."""
    try:
        with partial_file(path) as partial:
            partial.touch()
            raise _PossibleError
    except _PossibleError:
        return


class _PossibleError(Exception):
    """Thrown through a file that could be made so that it goes away."""


def _remove(partial: Path) -> None:
    """Away with an unfinished file, if it can be done; the reason that brought us here matters more."""
    try:
        partial.unlink(missing_ok=True)
    except OSError:
        return
