"""How late a live map is, and how many frames it skipped."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from openvox.core.types import InstanceMap, Step
from openvox.formats.tally import Numbers


@dataclass(frozen=True, slots=True)
class Status:
    """After a frame."""

    frames: int
    """That arrived and were stepped, skipped ones included."""
    mapped: int
    dropped: int
    """Skipped because the mapper or perception were behind."""
    latency_ms: float
    """From the last mapped frame's arrival to the updated map."""
    voxels: int


class Gauge:
    """The first of the observers: it takes the time when the map is updated. `expect` comes before each step."""

    def __init__(self, tell: Callable[[Status], None]) -> None:
        self._tell = tell
        self._arrived, self._skipped = 0.0, False
        self.dropped = Numbers()
        self.latencies: list[float] = []
        """Milliseconds of every mapped frame."""
        self.status = Status(0, 0, 0, 0.0, 0)

    def expect(self, arrived: float, skipped: bool) -> None:
        """When the frame of the next step came, in seconds of time.perf_counter."""
        self._arrived, self._skipped = arrived, skipped

    def on_step(self, step: Step) -> None:
        """The map is updated."""
        if self._skipped:
            self.dropped.add(step.frame.index)
        elif step.looked:
            self.latencies.append(1000 * (time.perf_counter() - self._arrived))
        latency = self.latencies[-1] if self.latencies else 0.0
        frames = self.status.frames + 1
        self.status = Status(frames, len(self.latencies), self.dropped.count, latency, step.voxels)
        self._tell(self.status)

    def curves(self) -> dict[str, float]:
        """The numbers of the last step, for a viewer."""
        return {"latency": self.status.latency_ms, "dropped frames": float(self.status.dropped)}

    def close(self, result: InstanceMap) -> None:
        """Nothing is left to do."""
