"""Traces: `STEM.trace.mcap` with every decision, event and voxel change of a run.

Decisions are JSON with a schema, events foxglove.Log, voxel changes a message of ours: exact, so that the votes after
any frame can be rebuilt without mapping again.
"""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from openvox import __version__
from openvox.core.digest import START, canonical_json, chain
from openvox.core.errors import InputError
from openvox.core.types import Event, InstanceMap, Step
from openvox.formats import trace_schemas as schemas
from openvox.formats.mcap_io import McapWriter, Message, read_messages, read_metadata

FORMAT_VERSION = 1
METADATA = "openvox.trace"
BEGIN_METADATA = f"{METADATA}.begin"
"""What is known before the first frame; all that an unfinished file has."""
SUFFIX = ".trace.mcap"
_WAITING = 16


@dataclass(frozen=True)
class TraceInfo:
    """What a trace says about itself."""

    path: Path
    frames: int
    digest: str
    """Chain over the frames' decisions."""
    run: Mapping[str, Any]
    """preset, engine, parameters, recording and its digest, perception and its digest."""


@dataclass(frozen=True, eq=False)
class TraceFrame:
    """One frame of a trace."""

    frame: int
    stamp_ns: int
    looked: bool
    decisions: tuple[Mapping[str, Any], ...]
    """Fields of core.types.Decision, and the mask's caption and kind."""
    events: tuple[Event, ...]
    changes: schemas.VotesChanged
    regrouped: tuple[tuple[int, int], ...]
    """(fragment, instance) of each fragment that is new, or changed its instance here; empty in older traces."""


def decision_link(previous: str, frame: int, decisions: Sequence[Mapping[str, Any]]) -> str:
    """The next link of the trace digest: over canonical JSON of the frame's decisions, integers and rule names only.

    decisions: fields of core.types.Decision."""
    return chain(previous, canonical_json({"frame": frame, "decisions": decisions}))


class TraceWriter:
    """An observer that writes the trace in a thread of its own, complete or not at all; a context manager.

    run: what the trace says of its run. digest: the link to go on from, where a run is resumed. live: an error leaves
    what was written as NAME.partial. `digest` is whole after `close`."""

    def __init__(self, path: Path, run: Mapping[str, Any], digest: str = START, *, live: bool = False) -> None:
        self.path = path
        self._begin = {
            "format_version": str(FORMAT_VERSION),
            "openvox_version": __version__,
            "run": json.dumps(run, sort_keys=True),
        }
        self._file = McapWriter(path, live=live)
        self._steps: queue.Queue[Step | None] = queue.Queue(_WAITING)
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="trace", daemon=True)
        self.digest = digest
        self.frames = 0
        self._last = (0, 0)
        self._instance_of: Mapping[int, int] = {}
        self.seconds: list[float] = []
        """Time that each frame took to encode and write."""

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self._file)
            self._file.metadata(BEGIN_METADATA, self._begin)
            self._stack = stack.pop_all()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()
        self._stack.__exit__(kind, error, trace)

    def describe(self, run: Mapping[str, Any]) -> None:
        """What the trace says of its run, where it was not all known before."""
        self._begin["run"] = json.dumps(run, sort_keys=True)

    def on_step(self, step: Step) -> None:
        """Hand a step to the thread. Raises what the thread met, OutputError for a full disk."""
        if self._failure is not None:
            raise self._failure
        self._steps.put(step)

    def close(self, result: InstanceMap) -> None:
        """All steps are in the file, and what finishing dropped stands at the last frame; it is complete when the
        context ends. Raises what the thread met."""
        self._stop()
        if self._failure is not None:
            raise self._failure
        for event in result.events:
            self._file.add(schemas.EVENTS, *self._last, schemas.encode_event(self._last[1], event))
        self._file.metadata(METADATA, {**self._begin, "frames": str(self.frames), "digest": self.digest})

    def _stop(self) -> None:
        if self._thread.is_alive():
            self._steps.put(None)
            self._thread.join()

    def _work(self) -> None:
        while (step := self._steps.get()) is not None:
            if self._failure is None:
                try:
                    self._write(step)
                except BaseException as error:  # handed to the caller's thread
                    self._failure = error

    def _write(self, step: Step) -> None:
        begin = time.perf_counter()
        self.digest = decision_link(self.digest, step.frame.index, [asdict(one) for one in step.decisions])
        self.frames += 1
        self._last = (step.frame.index, step.frame.stamp_ns)
        number, stamp = step.frame.index, step.frame.stamp_ns
        self._file.add(schemas.DECISIONS, number, stamp, schemas.encode_decisions(step, self._instance_of))
        self._instance_of = step.instance_of
        for event in step.events:
            self._file.add(schemas.EVENTS, number, stamp, schemas.encode_event(stamp, event))
        self._file.add(schemas.VOXELS, number, stamp, schemas.encode_changes(stamp, step.changes))
        self.seconds.append(time.perf_counter() - begin)


def trace_info(path: Path) -> TraceInfo:
    """What the trace says about itself. Raises InputError."""
    record = read_metadata(path, METADATA, newest=FORMAT_VERSION)
    try:
        return TraceInfo(path, int(record["frames"]), record["digest"], json.loads(record["run"]))
    except (KeyError, ValueError) as error:
        raise InputError(f"{path}: its record {METADATA} is not as expected ({error}); replay again") from None


def read_trace(path: Path, start: int = 0) -> Iterator[TraceFrame]:
    """The frames of a trace from number `start` on, in order. Raises InputError."""
    trace_info(path)
    topics = {topic.name for topic in (schemas.DECISIONS, schemas.EVENTS, schemas.VOXELS)}
    group: list[Message] = []
    for message in read_messages(path, topics, from_sequence=start):
        if message.sequence < start:
            continue
        if group and message.sequence != group[0].sequence:
            yield frame_of(path, group)
            group = []
        group.append(message)
    if group:
        yield frame_of(path, group)


def read_decisions(path: Path, start: int = 0) -> Iterator[Mapping[str, Any]]:
    """`frame`, `looked` and `decisions` of every frame from number `start` on: what is read of a trace that only the
    decisions matter of. Raises InputError."""
    trace_info(path)
    for message in read_messages(path, {schemas.DECISIONS.name}, from_sequence=start):
        try:
            content = json.loads(bytes(message.data))
            decisions = tuple(content["decisions"])
            yield {"frame": message.sequence, "looked": bool(content["looked"]), "decisions": decisions}
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(
                f"{path}, frame {message.sequence}: the trace cannot be read ({error}); replay again"
            ) from None


def frame_of(path: Path, group: Sequence[Message]) -> TraceFrame:
    """A frame of its messages. Raises InputError."""
    where = f"{path}, frame {group[0].sequence}"
    try:
        by_topic: dict[str, list[memoryview]] = {}
        for message in group:
            by_topic.setdefault(message.topic, []).append(message.data)
        content = json.loads(bytes(by_topic[schemas.DECISIONS.name][0]))
        events = [schemas.decode_event(group[0].sequence, data) for data in by_topic.get(schemas.EVENTS.name, [])]
        changes = schemas.decode_changes(by_topic[schemas.VOXELS.name][0])
        return TraceFrame(
            group[0].sequence,
            group[0].log_time,
            bool(content["looked"]),
            tuple(content["decisions"]),
            tuple(events),
            changes,
            tuple((int(fragment), int(instance)) for fragment, instance in content.get("regrouped", ())),
        )
    except (KeyError, ValueError, TypeError, RecursionError, DecodeError) as error:
        raise InputError(f"{where}: the trace cannot be read ({error}); replay again") from None


def votes_after(path: Path, frame: int) -> tuple[NDArray[np.int32], dict[tuple[int, int], int]]:
    """The map's votes after a frame: voxel index (n, 3), and the count of every (voxel number, fragment) with votes."""
    index: list[NDArray[np.int32]] = []
    counts: dict[tuple[int, int], int] = {}
    for step in read_trace(path):
        if step.frame > frame:
            break
        index.append(step.changes.new_index)
        for voxel, fragment, count in zip(
            step.changes.voxel.tolist(), step.changes.fragment.tolist(), step.changes.count.tolist(), strict=True
        ):
            counts[voxel, fragment] = count
    left = {key: count for key, count in counts.items() if count}
    return (np.concatenate(index) if index else np.zeros((0, 3), np.int32)), left
