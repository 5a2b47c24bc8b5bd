"""Sets of frame numbers that may be united and counted exactly, small however long a recording is."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Self

BITS = 256
"""Frames a block: one that holds none of the set takes no room, so a set costs what it holds, not when it was."""


@dataclass(eq=False, slots=True)
class FrameSet:
    """Frame numbers from 0, as bits of Python integers by block."""

    blocks: dict[int, int] = field(default_factory=dict)

    def add(self, frame: int) -> None:
        """Enter one frame."""
        block = frame // BITS
        self.blocks[block] = self.blocks.get(block, 0) | 1 << frame % BITS

    def copy(self) -> FrameSet:
        """The same frames in a set of its own."""
        return FrameSet(self.blocks.copy())

    def __len__(self) -> int:
        return sum(bits.bit_count() for bits in self.blocks.values())

    @classmethod
    def union(cls, sets: Iterable[FrameSet]) -> Self:
        """Frames that are in any of the sets."""
        out: dict[int, int] = {}
        for one in sets:
            for block, bits in one.blocks.items():
                out[block] = out.get(block, 0) | bits
        return cls(out)
