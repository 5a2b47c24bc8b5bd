"""A sample of frames, small enough to hold: every pose and stamp, depth made coarse, a few whole pictures."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Frame, Intrinsics, Rig
from openvox.sources import Dropped

COLUMNS = 160
"""Of the coarse depth."""
PICTURES = 16
"""Frames whose colour is laid over depth, up to twice as many where it is not known how many come."""
GAP = 4.0
"""Times the usual time between frames: more is a gap."""

Floats = NDArray[np.float64]
_ROW = 6 + 16
"""Numbers that are kept of a frame; the last 16 are its pose."""


@dataclass(frozen=True, eq=False)
class Sample:
    """Frames in order. What is not known of a frame (brightness, where it was not decoded) is NaN."""

    rig: Rig
    """Of the first frame."""
    number: NDArray[np.int64]
    """(n,): frame numbers."""
    stamp: Floats
    """(n,): seconds since the first frame."""
    pose: Floats
    """(n, 4, 4): world_from_depth."""
    depth: NDArray[np.uint16]
    """(n, h, w): every few pixels of the depth pictures, millimetres; fewer pictures where frames are not compared."""
    camera: Intrinsics
    """Of `depth`."""
    valid: Floats
    """(n,): share of depth pixels with a measurement."""
    bright: Floats
    """(n,): 99th percentile of grey, 0 to 255."""
    contrast: Floats
    """(n,): between the 1st and the 99th percentile of grey."""
    block: NDArray[np.int64]
    """(n,): rising number of the stretch of neighbouring frames that a frame belongs to."""
    pictures: tuple[Frame, ...]
    """Some of the frames, whole."""
    dropped: Mapping[str, int]
    """Reason to number of frames."""

    def __len__(self) -> int:
        return len(self.number)

    def segments(self) -> NDArray[np.int64]:
        """(n,): as `block`, parted also where the stamps have a gap."""
        interval = usual_interval(self.stamp, self.block)
        part = (np.diff(self.block) > 0) | (np.diff(self.stamp) > GAP * interval)
        return np.concatenate([[0], np.cumsum(part)]).astype(np.int64)


def usual_interval(stamp: Floats, block: NDArray[np.int64]) -> float:
    """The median of the seconds between neighbours."""
    inside = np.diff(stamp)[np.diff(block) == 0]
    return float(np.median(inside)) if len(inside) else math.inf


def coarse_camera(camera: Intrinsics, step: int) -> Intrinsics:
    """The camera of every step-th pixel, from the first."""
    width, height = -(-camera.width // step), -(-camera.height // step)
    return Intrinsics(width, height, camera.fx / step, camera.fy / step, camera.cx / step, camera.cy / step)


@dataclass
class Taker:
    """Takes a sample, frame by frame. A frame costs 200 bytes, and more where its depth is kept."""

    first: Frame | None = None
    dropped: dict[str, int] = field(default_factory=dict)
    _rows: array[float] = field(default_factory=lambda: array("d"))
    _depth: list[NDArray[np.uint16]] = field(default_factory=list)
    _pictures: list[Frame] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._rows) // _ROW

    def drop(self, frame: Dropped) -> None:
        """Counts what the source left out."""
        self.dropped[frame.reason] = self.dropped.get(frame.reason, 0) + 1

    def add(self, frame: Frame, *, block: int = 0, look: bool = False, whole: bool = False, depth: bool = True) -> None:
        """The next frame. look: at its colour. whole: keep it, colour and all. depth: keep that, made coarse."""
        self.first = self.first or frame
        if frame.depth.shape != self.first.depth.shape:
            return
        coarse = frame.depth[:: self._step(), :: self._step()]
        seen = brightness(frame) if look else (math.nan, math.nan)
        stamp = (frame.stamp_ns - self.first.stamp_ns) / 1e9
        self._rows.extend((frame.index, stamp, float((coarse > 0).mean()), *seen, block))
        self._rows.extend(frame.world_from_depth.matrix().ravel().tolist())
        if depth:
            self._depth.append(coarse.copy())
        if whole and frame.color:
            self._pictures.append(replace(frame, truth_instances=None, truth_categories=None))

    def _step(self) -> int:
        assert self.first is not None
        return max(1, -(-self.first.rig.depth.width // COLUMNS))

    def done(self) -> Sample | None:
        """None if there was no frame."""
        if self.first is None:
            return None
        rows = np.array(self._rows).reshape(-1, _ROW)
        number, stamp, valid, bright, contrast, block = rows[:, :6].T
        return Sample(
            rig=self.first.rig,
            number=number.astype(np.int64),
            stamp=stamp,
            pose=rows[:, 6:].reshape(-1, 4, 4),
            depth=np.array(self._depth),
            camera=coarse_camera(self.first.rig.depth, self._step()),
            valid=valid,
            bright=bright,
            contrast=contrast,
            block=block.astype(np.int64),
            pictures=tuple(self._pictures[:: 1 + len(self._pictures) // (2 * PICTURES)]),
            dropped=self.dropped,
        )


def take_sample(blocks: Iterable[Iterable[Frame | Dropped]], expected: int) -> Sample | None:
    """Goes through stretches of frames, of about so many in all; None if there is no frame."""
    taker = Taker()
    share = min(1.0, 0.97 * PICTURES / expected)  # of an odd step, so that what recurs is not always met or missed
    for number, block in enumerate(blocks):
        for frame in block:
            if isinstance(frame, Dropped):
                taker.drop(frame)
            else:
                look = not len(taker) or int((len(taker) + 1) * share) > int(len(taker) * share)
                taker.add(frame, block=number, look=look, whole=look)
    return taker.done()


def brightness(frame: Frame) -> tuple[float, float]:
    """99th percentile of grey, and its distance from the 1st; NaN where there is no colour that can be decoded."""
    import cv2

    if not frame.color:
        return math.nan, math.nan
    image = cv2.imdecode(np.frombuffer(frame.color, np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_4)
    if image is None:
        return math.nan, math.nan
    low, high = np.percentile(image, [1, 99])
    return float(high), float(high - low)
