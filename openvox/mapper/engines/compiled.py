"""How kernels are compiled: once, kept where a folder can be written, and anew in every run where none can."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

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
