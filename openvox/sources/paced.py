"""A recording played at the pace at which it was made, or faster, or slower."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator

from openvox.core.types import Frame


def paced(frames: Iterable[Frame], rate: float, stop: threading.Event) -> Iterator[Frame]:
    """The frames, each no sooner than its stamp says, counted from the first and divided by `rate`.

    A frame that is late comes at once. Ends when `stop` is set."""
    begin: float | None = None
    first = 0
    for frame in frames:
        if begin is None:
            begin, first = time.monotonic(), frame.stamp_ns
        due = begin + (frame.stamp_ns - first) / 1e9 / rate
        if stop.wait(max(0.0, due - time.monotonic())):
            return
        yield frame
