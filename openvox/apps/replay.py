"""replay: the probabilistic mapper over a recording and its perception; no model runs, nothing is left to chance."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from openvox.apps.joined import joined_frames
from openvox.apps.loop import Observer, run
from openvox.apps.memory import MemoryLimit
from openvox.apps.passes import check_passes, first_passes, pass_row
from openvox.apps.resume import beginning, chain_state
from openvox.apps.timing import STAGES, Ran, Stopwatch, summary
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import MapperParameters, preset
from openvox.core.parameters import as_dict, from_assignments, from_toml, updated
from openvox.core.types import Frame, InstanceMap, Intrinsics, Mask, Pose, Rig, Step
from openvox.formats.ahead import read_ahead
from openvox.formats.growing import PARTIAL, final_name, finished_or_not, is_unfinished
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.map_npz import write_map
from openvox.formats.perception import SUFFIX as PERCEPTION_SUFFIX
from openvox.formats.perception import PerceptionInfo, perception_info
from openvox.formats.recording import RecordingInfo, recording_info
from openvox.formats.times import times_path, write_times
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.trace import TraceWriter
from openvox.mapper.engines.compiled import all_kept, watched
from openvox.mapper.mapper import Mapper


def replay(
    recording: Path,
    *,
    perception: Path | None = None,
    preset_name: str = "openvox",
    params: Path | None = None,
    assignments: Sequence[str] = (),
    engine: str = "cpu",
    out: str | None = None,
    resume: Path | None = None,
    passes: int = 1,
    max_memory: int | None = None,
    rerun: Path | None = None,
    images: Literal["none", "jpeg", "all"] = "jpeg",
    every: int = 1,
    start: int | None = None,
    end: int | None = None,
    stride: int = 1,
    read: Callable[..., Iterator[tuple[Frame, tuple[Mask, ...] | None]]] | None = None,
    progress: Callable[[int, int], None] | None = None,
    notice: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Map a recording and write STEM.map.npz and STEM.trace.mcap; the contract's fields of `replay --json`.

    perception: instead of STEM.perception.mcap. out: another STEM. resume: a map to go on from. passes: how often the
    frames are mapped; map, trace and the file for Rerun are the last pass's. images, every: see RerunObserver. read:
    instead of joined_frames. notice: told what takes long. Raises InputError, OutputError."""
    check_passes(passes, resume is not None)
    parameters = chosen_parameters(preset_name, params, assignments)
    source = recording_info(recording)
    found = perception_info(_perception_of(recording, perception))
    if is_unfinished(recording):  # more may come while it is mapped
        end = min(source.last + 1, source.last + 1 if end is None else end)
    stem = named_stem(out) if out else stem_of(recording)
    map_path, trace_path = Path(f"{stem}{MAP_SUFFIX}"), Path(f"{stem}{TRACE_SUFFIX}")
    outputs = [map_path, trace_path, times_path(trace_path), *([rerun] if rerun else [])]
    _check_outputs([recording, found.path, *([resume] if resume else [])], outputs)
    earlier = beginning(resume, preset_name, parameters, found, source)
    start = earlier.first_frame(start, stride, source, notice)
    replaced = [str(path) for path in outputs if path.exists()]
    warm_up(parameters, engine, notice)
    begin = time.perf_counter()
    watch, counter = Stopwatch(), Counting(progress, passes * _count(source, start, end, stride))
    about = {"preset": preset_name, "engine": engine, "parameters": as_dict(parameters)}
    sources = {
        name: (relative(info.path, trace_path), info.digest)
        for name, info in (("recording", source), ("perception", found))
    }
    mapper = (
        Mapper.resumed(earlier.map, parameters, watch, engine) if earlier.map else Mapper(parameters, watch, engine)
    )

    def frames() -> closing[Generator[tuple[Frame, tuple[Mask, ...] | None], None, None]]:
        return closing(read_ahead(_timed((read or joined_frames)(recording, found.path, start, end, stride), watch), 4))

    watching: list[Observer] = [counter, *([MemoryLimit(max_memory)] if max_memory else [])]
    rows, chain, before = first_passes(passes, mapper, frames, watching, earlier.chain)
    counter.begin_pass()
    said = {**earlier.said, **({"passes_before": rows} if rows else {})}
    with ExitStack() as stack:
        trace = stack.enter_context(TraceWriter(trace_path, {**about, "sources": sources, **said}, chain))
        ran = Ran()
        observers: list[Observer] = [trace, *watching, ran]
        if rerun is not None:
            from openvox.view.rerun_observer import RerunObserver

            shown = RerunObserver(
                rerun,
                voxel_size=parameters.map.voxel_size,
                images=images,
                every=every,
                earlier=before or earlier.map,
                stages=watch.last,
            )
            watch.times["rerun"] = shown.milliseconds
            observers.append(stack.enter_context(shown))
        run(stack.enter_context(frames()), mapper, observers)
        if not counter.frames:
            raise InputError(
                f"{recording}: no frame lies in the chosen range; openvox info {recording} shows the numbers"
            )
        if not counter.looked:
            raise InputError(
                f"{found.path}: it has masks for none of the chosen frames of {recording}; is it of another recording?"
            )
        result = mapper.finish()
        for observer in observers:
            observer.close(result)
    watch.times["trace"] = [1000 * value for value in trace.seconds]
    write_times(times_path(trace_path), ran.times(trace.digest, watch.times))
    # last, so that a map never stands beside a trace that could not be completed
    digests = {"recording": source.digest, "map": map_digest(result), "trace": trace.digest}
    meta = {
        **map_meta(about, found, sources, digests, earlier.frames + counter.frames),
        "last": counter.last,
        **said,
    }
    write_map(map_path, replace(result, meta=meta, state={**result.state, **chain_state(trace.digest)}))
    seconds = time.perf_counter() - begin
    return {
        "frames": counter.frames,
        "looked": counter.looked,
        "seconds": seconds,
        "frames_per_second": passes * counter.frames / seconds,
        "ms": {stage: summary(watch.times.get(stage, [])) for stage in (*STAGES, *(["rerun"] if rerun else []))},
        "voxels": len(result.voxel_index),
        "instances": len(result.instance_id),
        "decisions": dict(sorted(counter.rules.items())),
        "digests": digests,
        "passes": [*rows, pass_row(result, trace.digest)],
        "outputs": {
            "map": str(map_path),
            "trace": str(trace_path),
            "times": str(times_path(trace_path)),
            "rerun": str(rerun) if rerun else None,
        },
        "replaced": replaced,
        **about,
    }


def chosen_parameters(preset_name: str, params: Path | None, assignments: Sequence[str]) -> MapperParameters:
    """preset < file < --set. Raises InputError."""
    given = from_assignments(assignments)
    chosen = preset(preset_name)
    file = from_toml(params) if params else {}
    source = "--set" if not params else f"{params}, --set" if given else str(params)
    return updated(chosen, {**file, **given}, source=source)


def warm_up(parameters: MapperParameters, engine: str, notice: Callable[[str], None]) -> None:
    """Have all kernels compiled, or loaded from the cache, before any time is taken."""
    camera = Intrinsics(16, 16, 16.0, 16.0, 7.5, 7.5)
    both, left = np.zeros((2, 16, 16), np.bool_)
    both[2:14, 2:14] = left[2:14, 2:9] = True
    welded, parted = (Mask.from_bitmap(both),), (Mask.from_bitmap(left), Mask.from_bitmap(left[:, ::-1]))
    few = replace(  # whatever the switches, so small a world reaches every kernel that they can reach
        parameters,
        map=replace(parameters.map, voxel_size=0.04, max_depth=2.0),
        masks=replace(parameters.masks, min_pixels=0, erosion=min(1, parameters.masks.erosion), step_margin=1),
        evolution=replace(parameters.evolution, halving=1),
    )
    once = "once after an installation"
    if not all_kept():
        once = "as in every run: there is no folder to keep the compiled kernels in; set NUMBA_CACHE_DIR to one"
    with watched(lambda: notice(f"compiling the mapper's kernels, {once} ...")):
        mapper = Mapper(few, engine=engine)
        for number, masks in enumerate((welded, parted, parted)):
            frame = Frame(number, number, Pose.identity(), Rig(camera, camera), np.full((16, 16), 1000, np.uint16))
            mapper.step(frame, masks)
        mapper.finish()


class Counting:
    """Counts frames and the rules that decided, and reports progress."""

    def __init__(self, progress: Callable[[int, int], None] | None, total: int) -> None:
        self._progress, self._total = progress, total
        self._before = 0
        self.frames = self.looked = 0
        self.last = -1
        self.rules: Counter[str] = Counter()

    def begin_pass(self) -> None:
        """Count a new pass by itself; progress goes on."""
        self._before += self.frames
        self.frames = self.looked = 0
        self.rules.clear()

    def on_step(self, step: Step) -> None:
        """One frame more."""
        self.frames += 1
        self.looked += step.looked
        self.last = step.frame.index
        self.rules.update(decision.by for decision in step.decisions)
        if self._progress:
            self._progress(self._before + self.frames, self._total)

    def close(self, result: InstanceMap) -> None:
        """Nothing is left to do."""


def named_stem(out: str) -> Path:
    """The STEM that was asked for, also where a map or trace of it is named instead."""
    return Path(out.removesuffix(MAP_SUFFIX).removesuffix(TRACE_SUFFIX))


def stem_of(recording: Path) -> Path:
    """STEM of STEM.mcap; of STEM.mcap.partial STEM.partial, since a run under way may be writing STEM's files."""
    stem = final_name(recording).with_suffix("")
    return stem.with_name(stem.name + PARTIAL) if is_unfinished(recording) else stem


def _perception_of(recording: Path, perception: Path | None) -> Path:
    path = perception or finished_or_not(final_name(recording).with_suffix(PERCEPTION_SUFFIX))
    if not path.exists():
        raise InputError(f"{path}: no such file; run openvox perceive {recording} first, or name one with --perception")
    return path


def _check_outputs(inputs: Sequence[Path], outputs: Sequence[Path]) -> None:
    taken = {path.resolve() for path in inputs}
    for path in outputs:
        if path.resolve() in taken:
            raise InputError(f"{path}: would be overwritten by what is made from it; choose another --out")
        taken.add(path.resolve())


def _timed(
    frames: Iterator[tuple[Frame, tuple[Mask, ...] | None]], watch: Stopwatch
) -> Iterator[tuple[Frame, tuple[Mask, ...] | None]]:
    times = watch.times.setdefault("decode", [])
    while True:
        begin = time.perf_counter()
        item = next(frames, None)
        if item is None:
            return
        times.append(1000 * (time.perf_counter() - begin))
        yield item


def _count(source: RecordingInfo, start: int | None, end: int | None, stride: int) -> int:
    first = source.first if start is None else max(start, source.first)
    last = source.last + 1 if end is None else min(end, source.last + 1)
    return max(0, -(-(last - first) // stride))


def relative(path: Path, beside: Path) -> str:
    """From the folder of another file."""
    return Path(os.path.relpath(path.resolve(), beside.resolve().parent)).as_posix()


def map_meta(
    about: dict[str, Any],
    found: PerceptionInfo,
    sources: dict[str, tuple[str, str]],
    digests: dict[str, str],
    frames: int,
) -> dict[str, Any]:
    """What a map says of its run."""
    return {
        **about,
        "encoder": found.encoder,
        "encoder_model": next((stage.get("model_digest") for stage in found.stages if stage.get("role") == "enc"), ""),
        "frames": frames,
        "digests": {**digests, "perception": found.digest},
        "recording": sources["recording"][0],
        "perception": sources["perception"][0],
    }
