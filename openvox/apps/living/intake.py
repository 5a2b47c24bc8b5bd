"""Frames on their way to the mapper: all are recorded; where the mapper is behind, the oldest waiting one is skipped.

One thread receives and records, one looks (perception), and the mapper's own comes last. Frames never overtake each
other, and a skipped one keeps its place.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from openvox.core.types import Frame
from openvox.formats.ahead import read_ahead
from openvox.formats.perception import FrameMasks

T = TypeVar("T")
CAPACITY = 4
"""Frames that may wait: more would smooth longer hiccups and let every frame come later."""
CAPACITY_SEEN_NOW = 1
"""The same where a front end looks, which takes longer than a frame lasts: it had better look at the newest."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """A frame, when it came (seconds of time.perf_counter), and what was seen in it."""

    frame: Frame
    at: float
    found: FrameMasks | None = None
    """None: nobody looked, because it was skipped or perception does not look at it."""
    skipped: bool = False


class Backlog:
    """What waits for the mapper, in the order of arrival; at most `capacity` frames that are still to be looked at."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._waiting: deque[Arrival] = deque()
        self._skipped: deque[Arrival] = deque()  # all older than those that wait
        self._change = threading.Condition()
        self._ended = False
        self._error: BaseException | None = None

    def put(self, arrival: Arrival) -> None:
        """The newest frame; it never waits for room."""
        with self._change:
            if len(self._waiting) == self._capacity:
                self._skipped.append(_without_pixels(self._waiting.popleft()))
            self._waiting.append(arrival)
            self._change.notify()

    def end(self, error: BaseException | None = None) -> None:
        """No more will come; `error` is raised after the last."""
        with self._change:
            self._ended, self._error = True, error
            self._change.notify()

    def __iter__(self) -> Iterator[Arrival]:
        while (arrival := self._next()) is not None:
            yield arrival
        if self._error is not None:
            raise self._error

    def _next(self) -> Arrival | None:
        with self._change:
            while not (self._skipped or self._waiting or self._ended):
                self._change.wait()
            for line in (self._skipped, self._waiting):
                if line:
                    return line.popleft()
            return None


def intake(
    frames: Iterable[T],
    record: Callable[[T], Frame | None],
    look: Callable[[Frame], FrameMasks | None],
    stop: threading.Event,
    capacity: int,
) -> Generator[Arrival, None, None]:
    """All frames in order, each recorded at once, and looked at unless it was skipped.

    record: keeps what came, and says if it is a frame to map. Raises what any of the three raise, after the frames
    before it. Closing it, or `stop`, ends `frames` at the next."""
    backlog = Backlog(capacity)
    receiver = threading.Thread(
        target=_receive, args=(frames, record, backlog, stop), name="openvox receive", daemon=True
    )
    receiver.start()
    with closing(read_ahead(_looked_at(backlog, look), 1)) as arrivals:
        try:
            yield from arrivals
        finally:
            stop.set()
            receiver.join()


def _receive(frames: Iterable[T], record: Callable[[T], Frame | None], backlog: Backlog, stop: threading.Event) -> None:
    error: BaseException | None = None
    try:
        for item in frames:
            arrived = time.perf_counter()
            frame = record(item)
            if frame is not None:
                backlog.put(Arrival(frame, arrived))
            if stop.is_set():
                break
    except BaseException as raised:  # handed to the mapper's thread
        error = raised
    finally:
        backlog.end(error)


def _looked_at(backlog: Backlog, look: Callable[[Frame], FrameMasks | None]) -> Iterator[Arrival]:
    for arrival in backlog:
        yield arrival if arrival.skipped else replace(arrival, found=look(arrival.frame))


def _without_pixels(arrival: Arrival) -> Arrival:
    """Marked as skipped; its pixels, which nobody will look at, are let go."""
    frame = arrival.frame
    none = np.broadcast_to(np.uint16(0), frame.depth.shape)
    light = replace(frame, depth=none, color=b"", color_format="", truth_instances=None, truth_categories=None)
    return replace(arrival, frame=light, skipped=True)
