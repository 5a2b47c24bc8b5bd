"""ingest: a folder of RGB-D frames, or a robot's log, becomes a recording."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.apps.examining.finding import Finding
from openvox.apps.examining.frames import examine_frames
from openvox.apps.examining.sample import Taker
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import OPENVOX
from openvox.core.types import DepthImage
from openvox.core.voxels import RANGE
from openvox.formats.ahead import read_ahead
from openvox.formats.mcap_io import MAGIC
from openvox.formats.recording import RecordingWriter
from openvox.sources import Dropped, open_source

LOOK_EVERY, KEPT = 13, 64
"""Every so many-th picture is looked at, and so many of them for the unit of depth."""


@dataclass(frozen=True)
class IngestResult:
    """What was recorded. Lengths in metres."""

    output: str
    replaced: bool
    """An older file of that name was replaced."""
    source: str
    frames: int
    first: int
    last: int
    dropped: Mapping[str, int]
    """Reason to number of frames."""
    seconds: float
    path_length_m: float
    depth_range_m: tuple[float, float]
    """1st and 99th percentile of the measured depths (of every 16th pixel)."""
    has_truth: bool
    notes: tuple[str, ...]
    """What was assumed, invented or changed, a sentence each."""
    findings: tuple[Finding, ...]
    """What doctor finds in single frames: stamps, black pictures, missing depth, odd intrinsics."""
    digest: str


def ingest(
    source: Path,
    out: Path,
    *,
    format: str = "auto",  # noqa: A002 (the option's name)
    progress: Callable[[int, int], None] | None = None,
    **given: Any,
) -> IngestResult:
    """Records the frames of `source` in `out`, which appears complete or not at all.

    given: fields of sources.Options. Raises InputError, OutputError."""
    opened = open_source(source, format, **given)
    replaced = out.exists()
    _check_target(source, out, [given.get(name) for name in ("poses", "extrinsic", "color_from_depth", "camera")])
    extra = {"notes": json.dumps(opened.notes), "origin_m": json.dumps(given.get("origin", (0, 0, 0)))}
    depths = np.zeros(1 << 16, np.int64)
    taker = Taker()
    with (
        closing(read_ahead(opened.frames, ahead=4)) as frames,
        RecordingWriter(
            out, source=opened.kind, depth_unit=opened.depth_unit, categories=opened.categories, extra=extra
        ) as writer,
    ):
        for done, frame in enumerate(frames, 1):
            if isinstance(frame, Dropped):
                taker.drop(frame)
                writer.drop(frame.index, frame.reason)
            else:
                writer.add(frame)
                depths += _histogram(frame.depth)
                some = len(taker) % LOOK_EVERY == 0
                taker.add(frame, look=some, depth=some and len(taker) < KEPT * LOOK_EVERY)
            if progress is not None:
                progress(done, opened.total)
        sample = taker.done()
        notes = (*opened.notes, *opened.late_notes, *(far(sample.pose) if sample else ()))
        writer.describe(notes=json.dumps(notes))
    info = writer.info()
    return IngestResult(
        output=str(out),
        replaced=replaced,
        source=info.source,
        frames=info.frames,
        first=info.first,
        last=info.last,
        dropped=info.dropped,
        seconds=info.seconds,
        path_length_m=info.path_length_m,
        depth_range_m=_range(depths),
        has_truth=info.has_truth,
        notes=notes,
        findings=tuple(examine_frames(sample)) if sample else (),
        digest=info.digest,
    )


def far(pose: NDArray[np.float64]) -> list[str]:
    """A sentence if cameras are where the voxels' numbers end. pose: (n, 4, 4)."""
    reach, away = RANGE * OPENVOX.map.voxel_size, float(np.abs(pose[:, :3, 3]).max(initial=0.0))
    if away < reach:
        return []
    return [
        f"the camera is {away / 1000:.0f} km from the origin along an axis, voxels of {OPENVOX.map.voxel_size:g} m "
        f"reach {reach / 1000:.0f} km: replay would stop; ingest again with --origin "
        + ",".join(f"{value:.0f}" for value in pose[0, :3, 3])
    ]


def _check_target(source: Path, out: Path, others: Sequence[Any]) -> None:
    """Refuses to write over a file of the source, or one of the others."""
    if any(isinstance(path, Path | str) and out.resolve() == Path(path).resolve() for path in (source, *others)):
        raise InputError(f"{out} is read itself; name another file for the recording")
    if out.is_file() and out.resolve().is_relative_to(source.resolve()):
        with out.open("rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise InputError(f"{out} is a file of the source {source}; name another file for the recording")


def _histogram(depth: DepthImage) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """(65536,): how many of every 16th pixel have each depth in millimetres."""
    return np.bincount(depth[::4, ::4].ravel(), minlength=1 << 16)


def _range(depths: np.ndarray[tuple[int], np.dtype[np.int64]]) -> tuple[float, float]:
    """1st and 99th percentile in metres of a histogram in millimetres, 0 (no measurement) left out."""
    total = np.cumsum(depths[1:])
    if not total[-1]:
        return 0.0, 0.0
    low, high = (int(np.searchsorted(total, -(-total[-1] * percent // 100))) + 1 for percent in (1, 99))
    return low / 1000.0, high / 1000.0
