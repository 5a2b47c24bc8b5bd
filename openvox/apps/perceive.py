"""perceive: masks, captions and embeddings for the frames of a recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from openvox.apps.cores import cores
from openvox.core.errors import InputError, OutputError
from openvox.core.parameters import Value, from_assignments, updated
from openvox.core.types import Frame
from openvox.formats.atomic import only_writer
from openvox.formats.detections import DetectionFile
from openvox.formats.perception import (
    SUFFIX,
    FrameMasks,
    PerceptionWriter,
    interrupted,
    perception_info,
    read_masks,
    read_unfinished,
)
from openvox.formats.recording import RecordingInfo, read_frames, recording_info
from openvox.perception.held import Selection, held
from openvox.perception.parameters import PerceptionParameters
from openvox.perception.pipeline import ROLES, Pipeline, perceive_frames
from openvox.perception.stages import STAGES, Chosen, assigned, of_frontend, pipeline_of, read_models

Frontend = Literal["offline", "geometry", "oracle", "models"]
ENCODER = "minilm"
GIVEN = Chosen("detections", {}, {}, "--detections", Path())
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
    untouched: bool
    """True if the file held all of it already and was left as it was."""
    masks: int
    kinds: Mapping[str, int]
    """Number of masks of each kind."""
    skipped: int
    """Frame numbers of the detections that the recording lacks."""
    encoder: str
    computed: Mapping[str, int]
    """Number of frames that each stage was run on; what it had done before is not counted."""
    device: str
    """What these stages ran on, in a few words; "" if none ran that has a model."""
    digest: str
    seconds: float
    frames_per_second: float
    """Frames that any stage was run on, in all the seconds that this took."""
    notes: tuple[str, ...]
    """What else one should know, a sentence each."""


def perceive(
    recording: Path,
    *,
    frontend: Frontend | None = None,
    models: Path | None = None,
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

    frontend: offline (the default), geometry or oracle; models, a TOML file that chooses the stages (see
    perception/stages.py); or detections, a file of the user's own front end. assignments: `group.name=value` texts,
    also of the stages that such a file chooses, as `det.score=0.2`, over what it says; paths in them count from the
    current folder.
    start, end (exclusive), stride: frame numbers. jobs: threads, by default one a core; the result is the same. What an
    older file of that name, or an interrupted run, holds of the same stages is not done again, and frames that are not
    asked for stay in it.
    Raises InputError, OutputError."""
    began = time.perf_counter()
    changes = from_assignments(assignments)
    of_stages = {name: value for name, value in changes.items() if name.partition(".")[0] in STAGES}
    chosen = assigned(_chosen(frontend, models, detections), of_stages)
    parameters = _parameters(chosen, {name: value for name, value in changes.items() if name not in of_stages})
    _check_recording(recording)
    info = recording_info(recording)
    target = out or recording.with_name(recording.stem + SUFFIX)
    _check_target(target, recording, detections, models)
    jobs = cores() if jobs is None else jobs
    if jobs < 1:
        raise InputError(f"--jobs is {jobs}; expected 1 or more")
    selection = Selection(start, end, stride)
    notes: list[str] = []
    computed, lacking = dict.fromkeys(ROLES, 0), list[int]()
    with ExitStack() as stack:
        file = stack.enter_context(DetectionFile(detections)) if detections else None
        pipeline = _pipeline(info, parameters, file, chosen)
        found = held(target, info, pipeline, selection)
        if found.others:
            raise _would_be_lost(target, found.others)
        if found.complete and not found.asked:
            raise _nothing_seen(info, file)
        if found.complete:
            notes.append(f"{target.name} holds all of that already; nothing was done")
            lacking = [n for n in sorted(file.frames) if selection.has(n) and n not in found.asked] if file else []
            interrupted(target, forget=True)
        else:
            stack.enter_context(only_writer(target))
            work = _Work(info, pipeline, file, selection, found.beside, jobs, progress)
            computed, lacking = _write(target, work, notes)
    written = perception_info(target)
    seconds = time.perf_counter() - began
    return PerceiveResult(
        output=target,
        frontend=chosen.name,
        frames=written.frames,
        reused=written.frames - computed["enc"],
        untouched=found.complete,
        masks=written.masks,
        kinds=written.kinds,
        skipped=len(lacking),
        encoder=written.encoder,
        computed=computed,
        device=pipeline.device([role for role, frames in computed.items() if frames]),
        digest=written.digest,
        seconds=seconds,
        frames_per_second=computed["enc"] / seconds,
        notes=(*notes, *_skipped(detections, lacking)),
    )


@dataclass(frozen=True)
class _Work:
    """What is to be done. beside: frames not asked for, whose results stay."""

    info: RecordingInfo
    pipeline: Pipeline
    file: DetectionFile | None
    selection: Selection
    beside: frozenset[int]
    jobs: int
    progress: Callable[[int, int], None] | None

    def frames(self) -> Generator[Frame, None, None]:
        """Those asked for and those beside, in order."""
        if not self.beside:
            chosen = self.selection
            return read_frames(self.info.path, start=chosen.start, end=chosen.end, stride=chosen.stride)
        return self._both()

    def _both(self) -> Generator[Frame, None, None]:
        with closing(read_frames(self.info.path)) as frames:
            for frame in frames:
                if frame.index in self.beside or self.selection.has(frame.index):
                    yield frame


def _write(target: Path, work: _Work, notes: list[str]) -> tuple[dict[str, int], list[int]]:
    """The new file; how many frames each stage was run on, and frames of the detections that the recording lacks."""
    pipeline, file = work.pipeline, work.file
    lacking = {number for number in file.frames if work.selection.has(number)} if file else set[int]()
    computed, total = dict.fromkeys(ROLES, 0), len(work.beside) + _total(work.info, work.selection)
    left = interrupted(target)
    boxes = masks = 0
    with ExitStack() as stack:
        frames = stack.enter_context(closing(work.frames()))
        earlier = _earlier(target, left, notes)
        results = stack.enter_context(closing(perceive_frames(pipeline, frames, earlier, work.jobs)))
        writer = stack.enter_context(
            PerceptionWriter(
                target,
                work.info,
                stages=pipeline.described(),
                encoder=pipeline.enc.name,
                dimensions=pipeline.enc.dimensions,
            )
        )
        for done, (frame, found) in enumerate(results, 1):
            lacking.discard(frame.index)
            if found is not None:
                writer.add(found[0])
                boxes, masks = boxes + len(found[0].boxes), masks + len(found[0].masks)
                for role in found[1]:
                    computed[role] += 1
            if work.progress is not None:
                work.progress(done, max(done, total))
        if not writer.frames:
            raise _nothing_seen(work.info, file)
    if left is not None:
        left.unlink(missing_ok=True)
    if file is None and pipeline.det.name != "none":
        notes.extend(_fruitless(pipeline.det.name, boxes, masks))
    if work.beside:
        notes.append(f"{len(work.beside)} frames that were not asked for stay in {target.name} as they were")
    return computed, sorted(lacking)


def _fruitless(det: str, boxes: int, masks: int) -> Iterator[str]:
    """What a detector or a segmenter that does nothing looks like."""
    if not boxes:
        yield f"{det} found no box in any frame; is its score threshold too high, are its words those of the scene?"
    elif not masks:
        yield f"none of {boxes} boxes became a mask; do the files of the segmenter belong together?"


def _chosen(frontend: Frontend | None, models: Path | None, detections: Path | None) -> Chosen:
    if detections is not None and (frontend is not None or models is not None):
        other = f"--models {models}" if frontend is None else f"--frontend {frontend}"
        raise InputError(
            f"{other} and --detections {detections} are both given; masks come from one of them: leave the other out"
        )
    if detections is not None:
        return GIVEN
    if (models is not None) and frontend not in (None, "models"):
        raise InputError(f"--frontend {frontend} and --models {models} are both given; leave one of them out")
    if models is not None:
        return read_models(models)
    if frontend == "models":
        raise InputError("--frontend models wants --models FILE.toml, which names them; docs/models.md has examples")
    return of_frontend(frontend or "offline")


def _parameters(chosen: Chosen, changes: Mapping[str, Value]) -> PerceptionParameters:
    """Of all front ends; only those of the chosen one may be set."""
    parameters = updated(PerceptionParameters(), changes, source="--set")
    for name in changes:
        if name.partition(".")[0] not in chosen.groups:
            what = "come as they are" if chosen is GIVEN else f"are found by {chosen.name}"
            if chosen.name == "models":
                what += f" ({', '.join(chosen.names.values())})"
            raise InputError(f"--set: {name} has no effect here, because masks {what}; leave it out")
    return parameters


def _check_recording(recording: Path) -> None:
    if recording.is_dir():
        raise InputError(f"{recording} is a folder; make a recording of it first: openvox ingest {recording}")
    if recording.name.endswith(SUFFIX) and recording.is_file():
        raise InputError(
            f"{recording} is what was perceived in a recording; give the recording, "
            f"{recording.name.removesuffix(SUFFIX)}.mcap"
        )


def _check_target(target: Path, *inputs: Path | None) -> None:
    """Only what perceive made is replaced, or what has the name of it."""
    for path in inputs:
        if path is not None and path.exists() and target.exists() and target.samefile(path):
            raise InputError(f"{target} is an input; name another file to write with --out")
    if target.is_file() and target.stat().st_size and not target.name.endswith(SUFFIX):
        try:
            perception_info(target)
        except InputError:
            raise OutputError(
                f"{target} exists and is no perception file; name another file to write with --out, or remove it first"
            ) from None


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


def _would_be_lost(target: Path, frames: int) -> InputError:
    return InputError(
        f"{target} holds {frames} frames that are not asked for and were made in another way (other stages, "
        "parameters, models, or another recording), which this would lose; write another file with "
        "--out, or leave --start, --end and --stride out"
    )


def _total(info: RecordingInfo, selection: Selection) -> int:
    """Frames to come, at most: dropped ones left gaps."""
    last = info.last if selection.end is None else min(info.last, selection.end - 1)
    numbers = range(selection.start or 0, last + 1, selection.stride)
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
