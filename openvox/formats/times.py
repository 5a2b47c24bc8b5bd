"""Times: `STEM.times.json` beside a trace, with the milliseconds of every stage and frame.

A trace itself holds no times, so that the same input gives the same bytes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from openvox import __version__
from openvox.core.errors import InputError
from openvox.formats.atomic import partial_file
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX

FORMAT_VERSION = 1
SUFFIX = ".times.json"
LARGEST = 1 << 28
"""Bytes: days of frames. A larger file is none of ours."""


@dataclass(frozen=True, eq=False)
class Times:
    """How long a run took, frame by frame."""

    trace: str
    """Digest of the trace of the same run."""
    frames: Sequence[int]
    stages: Mapping[str, Sequence[float | None]]
    """Milliseconds by stage, one a frame; None where the stage did not run."""


def times_path(trace: Path) -> Path:
    """Where the times of a trace's run lie."""
    return trace.with_name(trace.name.removesuffix(TRACE_SUFFIX) + SUFFIX)


def write_times(path: Path, times: Times) -> None:
    """Raises OutputError."""
    stages = {
        stage: [None if value is None else round(value, 3) for value in values]
        for stage, values in times.stages.items()
    }
    about = {"format_version": FORMAT_VERSION, "openvox_version": __version__, "trace": times.trace}
    with partial_file(path) as partial:
        partial.write_text(
            json.dumps({**about, "frames": list(times.frames), "milliseconds": stages}) + "\n", encoding="utf-8"
        )


def read_times(path: Path) -> Times:
    """Raises InputError."""
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError("it is too large")
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format_version"] > FORMAT_VERSION:
            raise InputError(f"{path} is of format {content['format_version']}; use a newer openvox")
        times = Times(str(content["trace"]), content["frames"], content["milliseconds"])
        if not _rows(times.frames, len(times.frames), int):
            raise ValueError("its frames are no numbers")
        if not all(_rows(values, len(times.frames), (int, float, type(None))) for values in times.stages.values()):
            raise ValueError("its stages are not a number a frame")
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path} does not hold the times of a run ({error}); replay again") from None
    return times


def _rows(values: Any, length: int, kinds: Any) -> bool:
    """Whether this is a list of so many numbers, none of them infinite or below 0."""
    return (
        isinstance(values, list)
        and len(values) == length
        and all(
            isinstance(value, kinds) and not isinstance(value, bool) and (value is None or 0 <= value < math.inf)
            for value in values
        )
    )
