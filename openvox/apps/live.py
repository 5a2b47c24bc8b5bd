"""live: the loop of replay on a stream, its recording, perception, trace and map written as they come to be."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from openvox.apps.living.gauge import Gauge, Status
from openvox.apps.living.intake import Arrival, intake
from openvox.apps.living.looking import LiveFrontend
from openvox.apps.living.opening import Stream, open_recording, open_server
from openvox.apps.living.questions import Questions
from openvox.apps.living.shared_map import SharedMap, Snapshots
from openvox.apps.loop import Observer, run
from openvox.apps.memory import MemoryLimit
from openvox.apps.query import answers
from openvox.apps.replay import Counting, chosen_parameters, named_stem, relative, warm_up
from openvox.apps.resume import chain_state
from openvox.apps.timing import LATENCY, MAPPING, STAGES, Ran, Stopwatch, summary
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.parameters import as_dict
from openvox.core.types import Frame, Mask
from openvox.formats.growing import PARTIAL
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.map_npz import write_map
from openvox.formats.perception import SUFFIX as PERCEPTION_SUFFIX
from openvox.formats.perception import PerceptionWriter
from openvox.formats.recording import RecordingWriter
from openvox.formats.times import SUFFIX as TIMES_SUFFIX
from openvox.formats.times import write_times
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.trace import TraceWriter
from openvox.mapper.mapper import Mapper
from openvox.sources.source import Dropped, Options

SCHEMES = ("ws://", "wss://")


@dataclass(frozen=True)
class LiveFiles:
    """What a live run writes."""

    recording: Path
    perception: Path
    map: Path
    trace: Path
    times: Path
    rerun: Path | None

    @classmethod
    def of(cls, stem: Path, rerun: Path | None) -> LiveFiles:
        """STEM.mcap and what lies beside it."""
        recording, perception, found, trace, times = (
            Path(f"{stem}{suffix}") for suffix in (".mcap", PERCEPTION_SUFFIX, MAP_SUFFIX, TRACE_SUFFIX, TIMES_SUFFIX)
        )
        return cls(recording, perception, found, trace, times, rerun)

    @property
    def all(self) -> list[Path]:
        """Those that are written."""
        return [path for path in vars(self).values() if path is not None]

    def check(self, inputs: Sequence[Path]) -> None:
        """Raises InputError where something would be lost: a source, or what a crash has left."""
        taken = {path.resolve() for path in inputs}
        for path in self.all:
            partial = path.with_name(path.name + PARTIAL)
            if {path.resolve(), partial.resolve()} & taken:
                raise InputError(f"{path}: would be written over what the run reads; choose another --out")
            if partial.exists():
                raise InputError(
                    f"{partial} is there: a run is writing it, or a crash has left it; choose another --out, or save "
                    f"what it holds with openvox recover and remove it"
                )


def live(
    source: str,
    *,
    rate: float = 1.0,
    follow: bool = False,
    perception: Path | None = None,
    frontend: LiveFrontend | None = None,
    preset_name: str = "openvox",
    params: Path | None = None,
    assignments: Sequence[str] = (),
    engine: str = "cpu",
    out: str | None = None,
    max_memory: int | None = None,
    rerun: Path | None = None,
    connect: str | None = None,
    spawn: bool = False,
    publish: int | None = None,
    start: int | None = None,
    end: int | None = None,
    stride: int = 1,
    waiting: int | None = None,
    port: int = 0,
    world: str | None = None,
    camera: str | None = None,
    topics: Mapping[str, str] | None = None,
    stop: threading.Event | None = None,
    status: Callable[[Status], None] = lambda status: None,
    ready: Callable[[str], None] = lambda address: None,
    notice: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Map a stream while it comes, and write STEM.mcap, STEM.perception.mcap, STEM.trace.mcap and STEM.map.npz.

    source: a recording, played `rate` times as fast as it was made or, with follow, as it is written; or ws://HOST:PORT,
    a Foxglove server, of which world, camera and topics choose as of a log. waiting: frames that may wait; of more,
    the oldest is recorded but not mapped. port: of the loopback, to answer questions on; 0 = any, and `ready` is told
    the address. connect: URL of a Rerun viewer; spawn: open one, whose window outlives the run. publish: port of the
    loopback for a Foxglove server of boxes, captions and changed voxels; 0 = any. stop: set to end the run well, with
    what has come until then. status: told after every frame. The rest as replay's; so is the result, with `dropped`,
    `latency_ms`, and in `ms` also `record` and `perceive`. Raises InputError, OutputError: what was written so far
    stays as NAME.partial."""
    parameters = chosen_parameters(preset_name, params, assignments)
    if not 1e-3 <= rate <= 1e6:
        raise InputError(f"--rate is {rate}; expected 0.001 to 1000000 times the recording's pace")
    watch, stop = Stopwatch(), stop or threading.Event()
    if source.startswith(SCHEMES):
        options = Options(start=start, end=end, stride=stride, world=world, camera=camera, topics=topics or {})
        stream = open_server(source, perception=perception, frontend=frontend, options=options, stop=stop)
    else:
        stream = open_recording(
            Path(source),
            rate=rate,
            follow=follow,
            perception=perception,
            frontend=frontend,
            chosen=(start, end, stride),
            stop=stop,
            decoded=lambda seconds: watch.times.setdefault("decode", []).append(1000 * seconds),
        )
    for note in stream.notes:
        notice(note)
    files = LiveFiles.of(named_stem(out) if out else stream.stem, rerun)
    files.check(stream.inputs)
    replaced = [str(path) for path in files.all if path.exists()]
    about = {"preset": preset_name, "engine": engine, "parameters": as_dict(parameters)}
    warm_up(parameters, engine, notice)
    begin = time.perf_counter()
    shared = SharedMap(Mapper(parameters, watch, engine), {**about, "encoder": stream.eyes.encoder})
    gauge, counter, ran = Gauge(status), Counting(None, 0), Ran()
    limits: list[Observer] = [MemoryLimit(max_memory)] if max_memory else []
    with ExitStack() as stack:
        if spawn:
            from openvox.view.viewer import window

            connect = stack.enter_context(window())
        ready(stack.enter_context(Questions(lambda texts, top: _answer(shared, texts, top), port)))
        watchers = _watchers(stack, gauge, parameters.map.voxel_size, rerun, connect)
        if publish is not None:
            from openvox.view.foxglove_publisher import FoxglovePublisher

            publisher = stack.enter_context(FoxglovePublisher(publish, voxel_size=parameters.map.voxel_size))
            notice(f"publishing to {publisher.url}")
            watchers.append(publisher)
        made = _record(
            stream,
            files,
            about,
            shared,
            [gauge, counter, ran, *limits, *watchers],
            gauge,
            watch,
            stop,
            waiting or stream.waiting,
        )
    seconds = time.perf_counter() - begin
    stages = {stage: watch.times.get(stage, []) for stage in (*MAPPING, "trace")}
    write_times(files.times, ran.times(made["digests"]["trace"], {**stages, LATENCY: gauge.latencies}))
    return {
        "frames": counter.frames,
        "looked": counter.looked,
        "dropped": gauge.dropped.count,
        "latency_ms": summary(gauge.latencies),
        "seconds": seconds,
        "frames_per_second": counter.frames / seconds,
        "ms": {name: summary(watch.times.get(name, [])) for name in (*STAGES, "record", "perceive")},
        **made,
        "decisions": dict(sorted(counter.rules.items())),
        "outputs": {name: None if path is None else str(path) for name, path in vars(files).items()},
        "replaced": replaced,
        **about,
    }


def _answer(shared: SharedMap, texts: Sequence[str], top: int) -> dict[str, Any]:
    result = shared.finish()
    return {"queries": answers(result, "the map", texts, top), "frame": result.meta["last"]}


def _watchers(
    stack: ExitStack, gauge: Gauge, voxel_size: float, rerun: Path | None, connect: str | None
) -> list[Observer]:
    """Rerun, where it is asked for, into a file and into a viewer."""
    found: list[Observer] = []
    for target in (rerun, connect):
        if target is not None:
            from openvox.view.rerun_observer import RerunObserver

            observer = RerunObserver(target, voxel_size=voxel_size, stages=gauge.curves)
            found.append(stack.enter_context(observer))
    return found


def _record(
    stream: Stream,
    files: LiveFiles,
    about: dict[str, Any],
    shared: SharedMap,
    observers: Sequence[Observer],
    gauge: Gauge,
    watch: Stopwatch,
    stop: threading.Event,
    waiting: int,
) -> dict[str, Any]:
    """The run itself; the results that are known from its files."""
    eyes = stream.eyes
    seen = PerceptionWriter(
        files.perception, files.recording, stages=eyes.stages, encoder=eyes.encoder, dimensions=eyes.dimensions
    )
    recorder = RecordingWriter(
        files.recording,
        source=stream.kind,
        depth_unit=stream.depth_unit,
        categories=stream.categories,
        extra={"notes": json.dumps(stream.notes)},
        live=True,
    )
    trace = TraceWriter(files.trace, {**about, "sources": _sources(files, "", "")}, live=True)
    with seen, trace:
        with recorder, Snapshots(shared, files.map.with_name(files.map.name + PARTIAL)):
            arrivals = intake(stream.frames, _kept_by(recorder, watch), _looking(eyes.look, watch), stop, waiting)
            with closing(arrivals):
                run(_expected(arrivals, seen, gauge), shared, [*observers[:1], trace, *observers[1:]])
        if not seen.frames:
            raise InputError(f"{files.recording}: perception looked at none of its frames; is it of another recording?")
        result = shared.finish()
        seen.describe(recording_digest=recorder.digest, skipped=json.dumps(gauge.dropped.summary()))
        trace.describe({**about, "sources": _sources(files, recorder.digest, seen.digest)})
        for observer in (trace, *observers):
            observer.close(result)
    digests = {"recording": recorder.digest, "map": map_digest(result), "trace": trace.digest}
    meta = {
        **result.meta,
        "digests": {**digests, "perception": seen.digest},
        "recording": relative(files.recording, files.map),
        "perception": relative(files.perception, files.map),
        "skipped": gauge.dropped.summary(),
    }
    write_map(files.map, replace(result, meta=meta, state={**result.state, **chain_state(trace.digest)}))
    watch.times["trace"] = [1000 * value for value in trace.seconds]
    return {"voxels": len(result.voxel_index), "instances": len(result.instance_id), "digests": digests}


def _sources(files: LiveFiles, recording: str, perception: str) -> dict[str, tuple[str, str]]:
    """What the trace says of its sources: where they are, and their digests."""
    return {
        "recording": (relative(files.recording, files.trace), recording),
        "perception": (relative(files.perception, files.trace), perception),
    }


def _kept_by(recorder: RecordingWriter, watch: Stopwatch) -> Callable[[Frame | Dropped], Frame | None]:
    """Records what comes."""
    times = watch.times.setdefault("record", [])

    def keep(item: Frame | Dropped) -> Frame | None:
        begin = time.perf_counter()
        if isinstance(item, Dropped):
            recorder.drop(item.index, item.reason)
            return None
        recorder.add(item)
        times.append(1000 * (time.perf_counter() - begin))
        return item

    return keep


def _looking(look: Callable[[Frame], Any], watch: Stopwatch) -> Callable[[Frame], Any]:
    times = watch.times.setdefault("perceive", [])

    def timed(frame: Frame) -> Any:
        begin = time.perf_counter()
        found = look(frame)
        times.append(1000 * (time.perf_counter() - begin))
        return found

    return timed


def _expected(
    arrivals: Iterator[Arrival], seen: PerceptionWriter, gauge: Gauge
) -> Iterator[tuple[Frame, Sequence[Mask] | None]]:
    """What the loop steps; masks are written before they are mapped, so that replay has all that the map has."""
    for arrival in arrivals:
        gauge.expect(arrival.at, arrival.skipped)
        if arrival.found is None:
            seen.skip(arrival.frame.stamp_ns)
        else:
            seen.add(arrival.found)
        yield arrival.frame, None if arrival.found is None else arrival.found.masks
