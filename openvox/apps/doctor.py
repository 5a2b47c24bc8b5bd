"""doctor: what is there and what looks wrong, in a source before it is converted, a recording or a perception file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

from openvox.apps.examining.finding import Finding
from openvox.apps.info import kind_of
from openvox.core.errors import InputError
from openvox.core.types import Frame
from openvox.formats.mcap_io import read_metadata, read_topics
from openvox.formats.perception import PerceptionInfo, perception_info, read_masks
from openvox.formats.recording import FORMAT_VERSION, METADATA, read_frames, recording_info
from openvox.sources import Dropped, Options, Source, StampError, open_source

MOST_FRAMES = 400
"""Are looked at, of a source or recording, so that memory and time do not grow with it."""
UNKNOWN_FRAMES = 100
"""Taken to be there, to choose pictures, where nobody knows."""
BLOCKS = 8
"""Stretches that they are taken from, where there are more."""
DEPTH_FRAMES = 24
"""Frames of a perception file whose masks are laid over depth."""

Progress = Callable[[int, int], None] | None
Blocks = Iterable[Iterable[Frame | Dropped]]


@dataclass(frozen=True)
class DoctorResult:
    """What was looked at and found."""

    path: str
    kind: str
    """recording, perception, or the layout of a source."""
    frames: int
    """That were looked at."""
    total: int
    """Frames that there are; 0 if that is not known."""
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]
    """What could not be told, and why; no faults."""


def doctor(path: Path, *, format: str = "auto", progress: Progress = None, **given: Any) -> DoctorResult:  # noqa: A002
    """Looks for what goes wrong most often. The same files give the same findings.

    given: fields of sources.Options, for a source; start and end also for a recording. Raises InputError."""
    kind = _kind(path)
    if kind in ("map", "trace"):
        raise InputError(
            f"{path} is a {kind}; doctor looks at what a map is made from: a source, a recording or a perception file"
        )
    if kind != "source" and (format != "auto" or Options(**given) != _range(Options(**given))):
        raise InputError(
            f"{path} is a {kind}, which is read as it is; options beside --start and --end are for sources"
        )
    if kind == "perception":
        return _perception(path, progress)
    if kind == "recording":
        return _recording(path, progress, **given)
    try:
        return _source(path, format, progress, given)
    except InputError:
        if path.is_file() and path.suffix == ".mcap":
            read_topics(path)  # of a damaged file this says more
        raise


def _kind(path: Path) -> str:
    """As info says; source for everything else."""
    if not path.is_file():
        return "source"
    try:
        kind = kind_of(path)
        if kind == "recording":
            read_metadata(path, METADATA, newest=FORMAT_VERSION)
        return kind
    except InputError:
        if path.suffix in (".partial", ".npz"):
            raise
        return "source"


def _range(options: Options) -> Options:
    return Options(start=options.start, end=options.end, stride=options.stride)


def _recording(
    path: Path, progress: Progress, *, start: int | None = None, end: int | None = None, **_: Any
) -> DoctorResult:
    info = recording_info(path)
    first, last = max(start or 0, info.first), min(info.last + 1 if end is None else end, info.last + 1)
    if first >= last:
        raise InputError(f"{path} has frames {info.first} to {info.last}; none of them is asked for")
    total = info.frames if (start, end) == (None, None) else min(info.frames, last - first)
    wide = (info.last + 1 - info.first) / info.frames  # numbers a frame
    blocks = (read_frames(path, start=a, end=b, truth=False) for a, b in _stretches(first, last, total, wide))
    found = examined(path, "recording", blocks, total, progress)
    dropped = [f"{count} frames of the source were left out: {reason}" for reason, count in info.dropped.items()]
    return replace(found, notes=(*dropped, *found.notes))


def _stretches(first: int, last: int, total: int, wide: float = 1.0) -> list[tuple[int, int]]:
    """Frame numbers from, to before: all, or stretches spread evenly."""
    if total <= MOST_FRAMES:
        return [(first, last)]
    length = max(1, int(MOST_FRAMES / BLOCKS * wide))
    return [(a, a + length) for a in (first + (last - length - first) * i // (BLOCKS - 1) for i in range(BLOCKS))]


def _source(path: Path, format: str, progress: Progress, given: dict[str, Any]) -> DoctorResult:  # noqa: A002
    findings: list[Finding] = []
    try:
        opened = open_source(path, format, **given)
    except StampError as error:
        findings.append(_bad_stamps(str(error)))
        given = {**given, "invent_stamps": True}
        opened = open_source(path, format, **given)
    whole = given.get("start") is None and given.get("end") is None and given.get("stride", 1) == 1
    if opened.total > MOST_FRAMES and whole:
        blocks: Blocks = _source_blocks(path, format, given, opened.total)
    else:
        blocks = [islice(opened.frames, MOST_FRAMES)]
    found = examined(path, opened.kind, blocks, opened.total, progress)
    return replace(
        found, findings=(*findings, *found.findings), notes=(*opened.notes, *opened.late_notes, *found.notes)
    )


def _source_blocks(path: Path, format: str, given: dict[str, Any], total: int) -> Iterator[Iterable[Frame | Dropped]]:  # noqa: A002
    """Stretches of a folder; a stretch of numbers that it does not have is left out."""
    for start, end in _stretches(0, total, total):
        try:
            part: Source = open_source(path, format, **{**given, "start": start, "end": end})
        except InputError:
            continue
        yield part.frames


def _bad_stamps(text: str) -> Finding:
    return Finding(
        "clock",
        f"The stamps cannot be used: {text}.",
        "stamps that do not rise",
        "the clock was set back while recording, or lines are missing or repeated",
        "openvox ingest with --invent-stamps --fps N, or correct the file",
    )


def examined(path: Path, kind: str, blocks: Blocks, total: int, progress: Progress) -> DoctorResult:
    """All findings of stretches of frames, of which there are about `total`. Raises InputError if there is none."""
    from openvox.apps.examining.frames import examine_frames
    from openvox.apps.examining.motion import examine_motion
    from openvox.apps.examining.registration import examine_registration
    from openvox.apps.examining.sample import take_sample

    expected = min(total or MOST_FRAMES, MOST_FRAMES)
    sample = take_sample(_watched(blocks, expected, progress), expected if total else UNKNOWN_FRAMES)
    if sample is None:
        raise InputError(f"{path} has no frame that can be used; openvox ingest says why")
    findings = examine_frames(sample)
    codes = {finding.code for finding in findings}
    notes: list[str] = []
    if len(sample) < total:
        notes.append(f"{len(sample)} of {total} frames were looked at")
    elif not total and len(sample) >= MOST_FRAMES:
        notes.append(f"the first {len(sample)} frames were looked at; --start N looks further on")
    if not codes & {"intrinsics", "depth_missing", "depth_unit"}:
        more, said = examine_motion(sample)
        findings, notes = [*findings, *more], [*notes, *said]
        codes |= {finding.code for finding in more}
    if not codes & {"black", "intrinsics", "depth_missing"}:
        more, said = examine_registration(sample)
        findings, notes = [*findings, *more], [*notes, *said]
    if not sample.pictures:
        notes.append("there is no colour")
    return DoctorResult(str(path), kind, len(sample), total, tuple(findings), tuple(notes))


def _watched(blocks: Blocks, expected: int, progress: Progress) -> Iterator[Iterator[Frame | Dropped]]:
    done = 0

    def through(block: Iterable[Frame | Dropped]) -> Iterator[Frame | Dropped]:
        nonlocal done
        for frame in block:
            yield frame
            done += 1
            if progress is not None:
                progress(min(done, expected - 1), expected)

    for block in blocks:
        yield through(block)
    if progress is not None:
        progress(expected, expected)


def _perception(path: Path, progress: Progress) -> DoctorResult:
    from openvox.apps.examining.detected import Depth, count, examine_masks

    info = perception_info(path)
    recording = _recording_of(info)
    every = max(1, info.frames // DEPTH_FRAMES)
    done = 0

    def depth_of(number: int) -> Depth | None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, info.frames)
        if recording is None or (done - 1) % every:
            return None
        frame = next(read_frames(recording, start=number, end=number + 1, ahead=0, truth=False), None)
        return None if frame is None else (frame.depth, frame.rig)

    findings = tuple(examine_masks(count(read_masks(path), depth_of)))
    notes = () if recording else ("its recording is not beside it, so that masks were not laid over depth",)
    return DoctorResult(str(path), "perception", info.frames, info.frames, findings, notes)


def _recording_of(info: PerceptionInfo) -> Path | None:
    """The recording that a perception file names, if it is there and the same."""
    path = info.path.parent / info.recording
    try:
        return path if recording_info(path).digest == info.recording_digest else None
    except InputError:
        return None
