"""How kernels are compiled: once, kept where a folder can be written, and anew in every run where none can."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from numba import njit
from numba.core import event

_not_kept: list[str] = []


def kernel(function: Callable[..., Any], **options: Any) -> Any:
    """The function, compiled at its first call; it gives up the interpreter's lock while it runs.

    numba keeps the code beside the source, else in the user's cache folder, or in NUMBA_CACHE_DIR if that is set."""
    try:
        return njit(cache=True, nogil=True, **options)(function)
    except (RuntimeError, OSError):  # there is no folder that numba can write
        _not_kept.append(function.__name__)
        return njit(nogil=True, **options)(function)


def all_kept() -> bool:
    """False if there is no folder to keep compiled kernels in."""
    return not _not_kept


class _Compiling(event.Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell
        self._told = False

    def on_start(self, event: event.Event) -> None:
        if not self._told:
            self._told = True
            self._tell()

    def on_end(self, event: event.Event) -> None:
        """Nothing to say."""


def watched(tell: Callable[[], None]) -> AbstractContextManager[Any]:
    """While open, `tell` is called once if a kernel must be compiled; kernels that are kept are only loaded."""
    watching: AbstractContextManager[Any] = event.install_listener("numba:compile", _Compiling(tell))
    return watching
