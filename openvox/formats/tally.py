"""What is counted of a recording while it is written, or found in an unfinished one."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from openvox.core.digest import START, frame_digest, recording_link
from openvox.core.types import Frame

MAX_RANGES = 1000


@dataclass
class Tally:
    """What is counted while frames are written, or found in an unfinished file."""

    digest: str = START
    frames: int = 0
    first: Frame | None = None
    last: Frame | None = None
    path_length: float = 0.0
    has_color: bool = False
    has_truth: bool = False

    def add(self, frame: Frame) -> None:
        """The next frame."""
        self.digest = recording_link(self.digest, frame_digest(frame), frame)
        if self.last is not None:
            here, there = frame.world_from_depth.translation, self.last.world_from_depth.translation
            self.path_length += math.dist(here, there)
        self.first, self.last = self.first or frame, frame
        self.frames += 1
        self.has_color |= bool(frame.color)
        self.has_truth |= frame.truth_instances is not None

    def record(self) -> dict[str, str]:
        """As the metadata at the end have it."""
        assert self.first is not None
        assert self.last is not None
        return {
            "frames": str(self.frames),
            "first": str(self.first.index),
            "last": str(self.last.index),
            "seconds": repr((self.last.stamp_ns - self.first.stamp_ns) / 1e9),
            "path_length_m": repr(self.path_length),
            "has_color": json.dumps(self.has_color),
            "has_truth": json.dumps(self.has_truth),
            "digest": self.digest,
        }


class Numbers:
    """Rising frame numbers, kept as at most MAX_RANGES ranges; the count is always exact."""

    def __init__(self) -> None:
        self.count = 0
        self._ranges: list[list[int]] = []

    def add(self, number: int) -> None:
        """The next number."""
        self.count += 1
        if self._ranges and self._ranges[-1][1] == number - 1:
            self._ranges[-1][1] = number
        elif len(self._ranges) < MAX_RANGES:
            self._ranges.append([number, number])

    def summary(self) -> dict[str, Any]:
        """count, and the first ranges, both ends included."""
        return {"count": self.count, "ranges": self._ranges}


def reasons(dropped: Mapping[str, Numbers]) -> str:
    """What was dropped, for a sentence."""
    parts = ", ".join(f"{numbers.count} with {reason}" for reason, numbers in sorted(dropped.items()))
    return f" (dropped: {parts})" if parts else ""
