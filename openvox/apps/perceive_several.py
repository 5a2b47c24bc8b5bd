"""perceive for several recordings side by side: each in a process of its own, so that one that fails costs no other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from openvox.apps.cores import cores
from openvox.apps.perceive import PerceiveResult, perceive
from openvox.apps.sweeping.pool import in_processes
from openvox.core.errors import InputError


def perceive_several(
    recordings: Sequence[Path],
    *,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> list[PerceiveResult | str]:
    """Of each recording what was found, or a sentence if it failed.

    jobs: how much is done at a time, by default one a core: that many recordings, and if there are fewer, frames of
    each. options: of apps.perceive. progress: of recordings. Raises InputError."""
    given = [recording.resolve() for recording in recordings]
    twice = [str(path) for path, place in zip(recordings, given, strict=True) if given.count(place) > 1]
    if twice:
        raise InputError(f"{twice[0]} is given twice; give it once")
    jobs = cores() if jobs is None else jobs
    if jobs < 1:
        raise InputError(f"--jobs is {jobs}; expected 1 or more")
    each = max(1, jobs // len(recordings))
    results: list[PerceiveResult | str] = [""] * len(recordings)
    work = partial(_one, options={**options, "jobs": each})
    for done, outcome in enumerate(in_processes(work, list(recordings), jobs), 1):
        results[outcome.place] = outcome.result if outcome.result is not None else outcome.error or ""
        if progress is not None:
            progress(done, len(recordings))
    return results


def _one(recording: Path, options: Mapping[str, Any]) -> PerceiveResult:
    return perceive(recording, **options)
