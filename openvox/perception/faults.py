"""Faults that detectors make, put into true masks: missed, merged, split, too large or too small.

Every fault lasts an episode of some frames, as those of real detectors do. Chance is a hash of the seed, the fault, the
instances and the episode: the same on every machine, for every frame by itself, whatever frames come before.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from openvox.perception.parameters import OracleParameters

Bitmap = NDArray[np.bool_]


class Faults:
    """The faults of one frame."""

    def __init__(self, parameters: OracleParameters, frame: int) -> None:
        self._p = parameters
        self._episode = frame // parameters.episode

    def masks(self, things: Mapping[int, Bitmap]) -> list[Bitmap]:
        """Bitmaps of the frame's instances, by id, as a detector might give them: in the order of their lowest id."""
        out = []
        for number, bitmap in self._merged(things).items():
            if self._draw("miss", number) < self._p.miss:
                continue
            parts = self._split(number, bitmap) if self._draw("split", number) < self._p.split else [bitmap]
            reach = self._p.boundary * (2.0 * self._draw("boundary", number) - 1.0)
            out += [_resized(part, round(reach)) for part in parts]
        return [bitmap for bitmap in out if bitmap.any()]

    def _draw(self, what: str, *numbers: int) -> float:
        """A number in [0, 1)."""
        text = "/".join(map(str, (self._p.seed, what, *numbers, self._episode)))
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big") / (1 << 48)

    def _merged(self, things: Mapping[int, Bitmap]) -> dict[int, Bitmap]:
        """Touching pairs as one, named by the lower id."""
        out = dict(things)
        name = {number: number for number in things}
        for a in sorted(things) if self._p.merge else ():
            grown = _resized(things[a], 2)
            for b in sorted(things):
                if a < b and self._draw("merge", a, b) < self._p.merge and (grown & things[b]).any():
                    keep, gone = sorted((name[a], name[b]))
                    if keep != gone:
                        out[keep] = out[keep] | out.pop(gone)
                        name = {number: keep if to == gone else to for number, to in name.items()}
        return out

    def _split(self, number: int, bitmap: Bitmap) -> list[Bitmap]:
        """Two parts, cut across the longer side of the box, somewhere in its middle third."""
        spans = [np.flatnonzero(bitmap.any(1 - axis)) for axis in (0, 1)]
        axis = max((0, 1), key=lambda axis: int(spans[axis][-1] - spans[axis][0]))
        low, high = int(spans[axis][0]), int(spans[axis][-1]) + 1
        at = low + int((high - low) * (1.0 + self._draw("cut", number)) / 3.0)
        first = np.arange(bitmap.shape[axis]) < at
        first = first[:, None] if axis == 0 else first[None, :]
        return [bitmap & first, bitmap & ~first]


def _resized(bitmap: Bitmap, pixels: int) -> Bitmap:
    """Grown by so many pixels in each of four directions at a time, or shrunk if below 0."""
    if pixels < 0:
        return ~_resized(~bitmap, -pixels)
    for _ in range(pixels):
        grown = bitmap.copy()
        grown[1:] |= bitmap[:-1]
        grown[:-1] |= bitmap[1:]
        grown[:, 1:] |= bitmap[:, :-1]
        grown[:, :-1] |= bitmap[:, 1:]
        bitmap = grown
    return bitmap
