"""Decoded frames that a process keeps between items, as long as they are of one recording and few enough."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from openvox.apps.joined import joined_frames
from openvox.core.types import Frame, Mask

LIMIT = 256 << 20
"""Bytes of pixels and masks that a process keeps; of a longer recording nothing is kept."""
Joined = tuple[Frame, tuple[Mask, ...] | None]
_kept: dict[tuple[Any, ...], list[Joined]] = {}


def shared_frames(
    recording: Path, perception: Path, start: int | None, end: int | None, stride: int
) -> Iterator[Joined]:
    """As apps.joined.joined_frames; decoded once for all items in a row that ask for the same. Raises InputError."""
    files = [(path.resolve(), path.stat().st_mtime_ns, path.stat().st_size) for path in (recording, perception)]
    key = (*files, start, end, stride)
    if key in _kept:
        yield from _kept[key]
        return
    _kept.clear()
    frames: list[Joined] = []
    size = 0
    for frame, masks in joined_frames(recording, perception, start, end, stride):
        size += frame.depth.nbytes + len(frame.color) + sum(_bytes(mask) for mask in masks or ())
        if size <= LIMIT:
            frames.append((frame, masks))
        else:
            frames.clear()
        yield frame, masks
    if size <= LIMIT:
        _kept[key] = frames


def _bytes(mask: Mask) -> int:
    return mask.bits.nbytes + (0 if mask.embedding is None else mask.embedding.nbytes)
