"""Frames of a recording with what perception found in them."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from openvox.core.digest import frame_digest
from openvox.core.errors import InputError
from openvox.core.types import Frame, Mask
from openvox.formats.perception import read_masks
from openvox.formats.recording import read_frames


class Numbered(Protocol):
    """A frame, or what was found in one."""

    @property
    def index(self) -> int:
        """The frame's number."""


T = TypeVar("T", bound=Numbered)


class Follower(Generic[T]):
    """Items with rising numbers (`index`), fetched as far as they are asked for."""

    def __init__(self, items: Iterator[T]) -> None:
        self._items = items
        self._next = next(items, None)

    def at(self, number: int) -> T | None:
        """The item of this number, None if there is none; numbers asked for must rise."""
        while self._next is not None and self._next.index < number:
            self._next = next(self._items, None)
        return self._next if self._next is not None and self._next.index == number else None


def joined_frames(
    recording: Path, perception: Path | None, start: int | None = None, end: int | None = None, stride: int = 1
) -> Generator[tuple[Frame, tuple[Mask, ...] | None], None, None]:
    """Every chosen frame with its masks, None where perception did not look. Raises InputError where they disagree."""
    found = Follower(read_masks(perception, start=start, end=end) if perception else iter(()))
    with closing(read_frames(recording, start=start, end=end, stride=stride, truth=False)) as frames:
        for frame in frames:
            masks = found.at(frame.index)
            if masks is not None and masks.frame_digest != frame_digest(frame):
                raise InputError(
                    f"{perception}, frame {frame.index}: its masks were made from other pixels than those of "
                    f"{recording}; run openvox perceive {recording} again"
                )
            yield frame, None if masks is None else masks.masks
