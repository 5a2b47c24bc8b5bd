"""perceive for several recordings side by side: each in a process of its own, so that one that fails costs no other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from openvox.apps.cores import cores
from openvox.apps.perceive import PerceiveResult, perceive
from openvox.apps.sweeping.cluster import cluster
from openvox.apps.sweeping.pool import Outcome, in_processes
from openvox.core.errors import InputError

Progress = Callable[[int, int], None] | None


@dataclass(frozen=True)
class SeveralResult:
    """`results`: of each recording, in their order, what was found, or a sentence if it failed. `seconds`: in all.
    `frames_per_second`: those that any stage was run on, of all recordings."""

    results: list[PerceiveResult | str]
    seconds: float
    frames_per_second: float


def perceive_several(
    recordings: Sequence[Path],
    *,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress = None,
    **options: Any,
) -> SeveralResult:
    """Every recording for itself; one that fails stops no other.

    jobs: how much is done at a time, by default one a core: that many recordings, and if there are fewer, frames of
    each. dask: address of a scheduler, whose workers do a recording each at a time; they must see
    the same files under the same paths. options: of apps.perceive. progress: of recordings. Raises InputError."""
    began = time.perf_counter()
    given = [recording.resolve() for recording in recordings]
    twice = [str(path) for path, place in zip(recordings, given, strict=True) if given.count(place) > 1]
    if twice:
        raise InputError(f"{twice[0]} is given twice; give it once")
    if dask is not None:
        whole = {name: value.resolve() if isinstance(value, Path) else value for name, value in options.items()}
        with cluster(dask) as found:
            return _collected(found.each(partial(_one, options=whole), given), recordings, progress, began)
    jobs = cores() if jobs is None else jobs
    if jobs < 1:
        raise InputError(f"--jobs is {jobs}; expected 1 or more")
    each = max(1, jobs // len(recordings))
    work = partial(_one, options={**options, "jobs": each})
    return _collected(in_processes(work, list(recordings), jobs), recordings, progress, began)


def _collected(
    outcomes: Iterable[Outcome[PerceiveResult]], recordings: Sequence[Path], progress: Progress, began: float
) -> SeveralResult:
    """What became of each, in the order of the recordings."""
    total = len(recordings)
    results: list[PerceiveResult | str] = [""] * total
    for done, outcome in enumerate(outcomes, 1):
        results[outcome.place] = outcome.result if outcome.result is not None else _told(outcome, recordings)
        if progress is not None:
            progress(done, total)
    seconds = time.perf_counter() - began
    frames = sum(result.computed["enc"] for result in results if isinstance(result, PerceiveResult))
    return SeveralResult(results, seconds, frames / seconds)


def _told(outcome: Outcome[PerceiveResult], recordings: Sequence[Path]) -> str:
    """The sentence of one that failed, with its recording: that of a process that died names none."""
    error, recording = outcome.error or "", recordings[outcome.place]
    return error if f"{recording.stem}." in error else f"{recording}: {error}"


def _one(recording: Path, options: Mapping[str, Any]) -> PerceiveResult:
    return perceive(recording, **options)
