"""How long the stages of a run take: of every frame, and in short."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np

from openvox.core.types import InstanceMap, Step
from openvox.formats.times import Times

MAPPING = ("masks", "project", "associate", "evolve")
STAGES = ("decode", *MAPPING, "trace")
LATENCY = "latency"
WHERE_LOOKED = frozenset({*MAPPING, LATENCY})
"""Stages of the frames that perception had looked at; the others are of every frame."""


class Stopwatch:
    """Milliseconds of every stage and frame."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {}
        self._stage, self._begin = "", 0.0

    def lap(self, stage: str) -> None:
        """A stage begins, and the one before ends; "" = none begins."""
        now = time.perf_counter()
        if self._stage:
            self.times.setdefault(self._stage, []).append(1000 * (now - self._begin))
        self._stage, self._begin = stage, now

    def last(self) -> dict[str, float]:
        """Milliseconds of the mapper's stages in the last frame that it looked at."""
        return {stage: self.times[stage][-1] for stage in MAPPING if self.times.get(stage)}


class Ran:
    """An observer: which frames the run had, and at which of them perception had looked."""

    def __init__(self) -> None:
        self.frames: list[int] = []
        self._looked: list[bool] = []

    def on_step(self, step: Step) -> None:
        """One frame more."""
        self.frames.append(step.frame.index)
        self._looked.append(step.looked)

    def close(self, result: InstanceMap) -> None:
        """Nothing is left to do."""

    def times(self, trace: str, of_stages: Mapping[str, Sequence[float]]) -> Times:
        """The run's times by frame. trace: its digest.

        of_stages: milliseconds of each stage; where it also ran in passes before, the last ones count."""
        always = [True] * len(self.frames)
        stages = {
            stage: _placed(values, self._looked if stage in WHERE_LOOKED else always)
            for stage, values in of_stages.items()
            if values
        }
        return Times(trace, self.frames, stages)


def _placed(values: Sequence[float], ran: Sequence[bool]) -> list[float | None]:
    """One entry a frame, None where the stage did not run."""
    last = iter(values[len(values) - sum(ran) :])
    return [next(last) if one else None for one in ran]


def summary(times: Sequence[float]) -> dict[str, float]:
    """mean, median, p95; zeros of nothing."""
    if not times:
        return {"mean": 0.0, "median": 0.0, "p95": 0.0}
    return {
        "mean": float(np.mean(times)),
        "median": float(np.median(times)),
        "p95": float(np.percentile(times, 95)),
    }
