"""perceive: masks, captions and embeddings for the frames of a recording."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from openvox.core.errors import InputError
from openvox.core.parameters import from_assignments, updated
from openvox.formats.detections import DetectionFile
from openvox.formats.perception import (
    SUFFIX,
    FrameMasks,
    PerceptionWriter,
    interrupted,
    read_masks,
    read_unfinished,
)
from openvox.formats.recording import RecordingInfo, read_frames, recording_info, selected
from openvox.perception.parameters import PerceptionParameters
from openvox.perception.pipeline import Pipeline, perceive_frames

Frontend = Literal["offline", "geometry", "oracle"]
GROUPS = {"offline": ("geometry", "offline"), "geometry": ("geometry",), "oracle": ("oracle",), "detections": ()}
"""The groups of parameters that each front end uses."""
ENCODER = "minilm"
NAMED_NUMBERS = 5
"""So many of the frame numbers that a recording lacks are named."""


@dataclass(frozen=True)
class PerceiveResult:
    """What was found, and where it was written."""

    output: Path
    frontend: str
    frames: int
    """That were looked at."""
    reused: int
    """Of these, the frames that an earlier run had done in the same way."""
    masks: int
    kinds: Mapping[str, int]
    """Number of masks of each kind."""
    skipped: int
    """Frame numbers of the detections that the recording lacks."""
    encoder: str
    digest: str
    seconds: float
    frames_per_second: float
    notes: tuple[str, ...]
    """What else one should know, a sentence each."""


def perceive(
    recording: Path,
    *,
    frontend: Frontend | None = None,
    detections: Path | None = None,
    out: Path | None = None,
    assignments: Sequence[str] = (),
    start: int | None = None,
    end: int | None = None,
    stride: int = 1,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PerceiveResult:
    """Runs Det, SegCap and Enc over a recording's frames; `out` appears complete or not at all.

    frontend: offline (the default), geometry or oracle; or detections, a file of the user's own front end. assignments:
    `group.name=value` texts. start, end (exclusive), stride: frame numbers. jobs: threads, by default one a core; the
    result is the same. What an older file of that name, or an interrupted run, holds of the same stages is not done
    again.
    Raises InputError, OutputError."""
    began = time.perf_counter()
    chosen = _chosen(frontend, detections)
    parameters = _parameters(chosen, assignments)
    info = recording_info(recording)
    target = out or recording.with_name(recording.stem + SUFFIX)
    _check_target(target, recording, detections)
    jobs = len(os.sched_getaffinity(0)) if jobs is None else jobs
    if jobs < 1:
        raise InputError(f"--jobs is {jobs}; expected 1 or more")
    notes: list[str] = []
    with ExitStack() as stack:
        file = stack.enter_context(DetectionFile(detections)) if detections else None
        pipeline = _pipeline(info, parameters, file, chosen)
        left = interrupted(target)
        frames = stack.enter_context(closing(read_frames(recording, start=start, end=end, stride=stride)))
        earlier = _earlier(target, left, notes)
        results = stack.enter_context(closing(perceive_frames(pipeline, frames, earlier, jobs)))
        writer = stack.enter_context(
            PerceptionWriter(
                target,
                info,
                stages=pipeline.described(),
                encoder=pipeline.enc.name,
                dimensions=pipeline.enc.dimensions,
            )
        )
        lacking = {number for number in file.frames if selected(number, start, end, stride)} if file else set[int]()
        reused, total = 0, _total(info, start, end, stride)
        for done, (frame, found) in enumerate(results, 1):
            lacking.discard(frame.index)
            if found is not None:
                writer.add(found[0])
                reused += found[1]
            if progress is not None:
                progress(done, max(done, total))
        if not writer.frames:
            raise _nothing_seen(info, file)
    if left is not None:
        left.unlink(missing_ok=True)
    written = writer.info()
    seconds = time.perf_counter() - began
    return PerceiveResult(
        output=target,
        frontend=chosen,
        frames=written.frames,
        reused=reused,
        masks=written.masks,
        kinds=written.kinds,
        skipped=len(lacking),
        encoder=written.encoder,
        digest=written.digest,
        seconds=seconds,
        frames_per_second=written.frames / seconds,
        notes=(*notes, *_skipped(detections, sorted(lacking))),
    )


def _chosen(frontend: Frontend | None, detections: Path | None) -> str:
    if frontend is not None and detections is not None:
        raise InputError(
            f"--frontend {frontend} and --detections {detections} are both given; masks come from one of them: "
            "leave the other out"
        )
    return "detections" if detections is not None else frontend or "offline"


def _parameters(chosen: str, assignments: Sequence[str]) -> PerceptionParameters:
    """Of all front ends; only those of the chosen one may be set."""
    changes = from_assignments(assignments)
    parameters = updated(PerceptionParameters(), changes, source="--set")
    for name in changes:
        if name.partition(".")[0] not in GROUPS[chosen]:
            what = "come as they are" if chosen == "detections" else f"are found by {chosen}"
            raise InputError(f"--set: {name} has no effect here, because masks {what}; leave it out")
    return parameters


def _check_target(target: Path, *inputs: Path | None) -> None:
    for path in inputs:
        if path is not None and path.exists() and target.exists() and target.samefile(path):
            raise InputError(f"{target} is an input; name another file to write with --out")


def _pipeline(
    info: RecordingInfo, parameters: PerceptionParameters, file: DetectionFile | None, chosen: Chosen
) -> Pipeline:
    """The stages of a front end, each module imported when it is used."""
    if file is None:
        return pipeline_of(chosen, info, parameters)
    from openvox.perception.captions import CaptionEncoder
    from openvox.perception.encoder import encoder
    from openvox.perception.given import GivenBoxes, GivenEmbeddings, GivenMasks

    enc = GivenEmbeddings(file) if file.encoder else CaptionEncoder(encoder(ENCODER))
    return Pipeline(GivenBoxes(file), GivenMasks(file), enc)


def _earlier(target: Path, left: Path | None, notes: list[str]) -> list[Iterator[FrameMasks]]:
    """What runs before this one found: in the file that is to be replaced, and in an interrupted one."""
    sources = []
    if target.exists():
        notes.append(f"an older {target.name} was replaced")
        sources.append(_until_damage(read_masks(target, boxes=True), notes))
    if left is not None:
        notes.append(f"an interrupted run had left a part of {target.name}; its whole frames were used where they fit")
        sources.append(read_unfinished(left))
    return sources


def _until_damage(found: Iterator[FrameMasks], notes: list[str]) -> Iterator[FrameMasks]:
    try:
        yield from found
    except InputError as error:
        notes.append(f"the older file could not be used again from there on: {error}")


def _total(info: RecordingInfo, start: int | None, end: int | None, stride: int) -> int:
    """Frames to come, at most: dropped ones left gaps."""
    last = info.last if end is None else min(info.last, end - 1)
    numbers = range(start or 0, last + 1, max(1, stride))
    return min(info.frames, sum(1 for number in numbers if number >= info.first))


def _nothing_seen(info: RecordingInfo, file: DetectionFile | None) -> InputError:
    where = f"{info.path} has frames {info.first} to {info.last}"
    if file is None:
        return InputError(f"{where}, none of which is asked for; choose others with --start, --end and --stride")
    if not file.frames:
        return InputError(f"{file.path} is empty; expected a line for each frame that was looked at")
    return InputError(
        f"{file.path} speaks of frames {min(file.frames)} to {max(file.frames)}, but none of them is among those asked "
        f"for ({where}); a frame's number is its index in the source, from 0"
    )


def _skipped(detections: Path | None, lacking: Sequence[int]) -> Iterator[str]:
    if lacking:
        named = ", ".join(str(number) for number in lacking[:NAMED_NUMBERS])
        more = ", ..." if len(lacking) > NAMED_NUMBERS else ""
        yield f"{len(lacking)} frames of {detections} are not in the recording and were skipped: {named}{more}"
