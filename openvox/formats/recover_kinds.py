"""A broken recording, perception or trace written anew from what salvage found, frame by frame."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from openvox.core.digest import START
from openvox.core.errors import InputError
from openvox.core.types import Decision, Rig
from openvox.formats import perception, perception_schemas, recording, schemas, trace, trace_schemas
from openvox.formats.frames import NEEDED, decode_frame
from openvox.formats.mcap_io import McapWriter, Message
from openvox.formats.recover import Gap, Salvage

Group = list[Message]
"""The messages of one frame."""


@dataclass(frozen=True)
class Loss:
    """What a topic lacks: everything after one stamp and before another (nanoseconds; None: the file's ends)."""

    topic: str
    after: int | None
    before: int | None
    reason: str


@dataclass
class Ledger:
    """What was kept and what was lost, by topic."""

    topics: tuple[str, ...]
    kept: dict[str, int] = field(default_factory=dict)
    lost: list[Loss] = field(default_factory=list)
    digest: str = START
    _last: dict[str, int] = field(default_factory=dict)
    _open: dict[str, tuple[int | None, str]] = field(default_factory=dict)

    def keep(self, group: Group) -> None:
        """A frame's messages were kept."""
        for message in group:
            self.kept[message.topic] = self.kept.get(message.topic, 0) + 1
            self._last[message.topic] = message.log_time
            if message.topic in self._open:
                self._close(message.topic, message.log_time)

    def lose(self, reason: str) -> None:
        """Something is missing here, on any topic."""
        for topic in self.topics:
            self._open.setdefault(topic, (self._last.get(topic), reason))

    @property
    def clean(self) -> bool:
        """True if nothing was lost so far."""
        return not (self.lost or self._open)

    def end(self) -> None:
        """The file ends here."""
        for topic in tuple(self._open):
            self._close(topic, None)

    def _close(self, topic: str, before: int | None) -> None:
        after, reason = self._open.pop(topic)
        self.lost.append(Loss(topic, after, before, reason))


def write_anew(found: Salvage, out: Path) -> tuple[str, Ledger]:
    """Writes the whole frames of a broken file to `out`; its kind, and what was kept and lost.

    Raises InputError, for a file that is none of ours, or of which no frame is whole."""
    for kind, (module, write) in KINDS.items():
        # the record at the end repeats the one at the beginning
        begin = found.metadata.get(module.BEGIN_METADATA) or found.metadata.get(module.METADATA)
        if begin is not None:
            ledger = Ledger(tuple(topic.name for topic in found.topics.values()))
            write(found, out, begin, ledger)
            end = found.metadata.get(module.METADATA, {}).get("digest")
            if end not in (None, ledger.digest) and ledger.clean:
                ledger.lose("not all frames are there")
            ledger.end()
            if end == ledger.digest:
                ledger.lost.clear()  # all frames are there; only what stands around them was broken
            return kind, ledger
    raise InputError(
        f"{found.path}: the record that says what it was made from is lost, or the file is none of openvox; make it "
        "again from its source"
    )


def _groups(found: Salvage, ledger: Ledger, wanted: set[str]) -> Iterator[Group]:
    """The messages of each frame. Next to a gap a frame must have all the topics that are wanted."""
    group: Group = []
    beside = True
    for piece in found.messages():
        gap = isinstance(piece, Gap)
        if group and (gap or piece.sequence != group[0].sequence):  # type: ignore[union-attr]
            yield from _if_whole(group, beside or gap, wanted)
            group, beside = [], False
        if isinstance(piece, Gap):
            ledger.lose(piece.reason)
            beside = True
        else:
            group.append(piece)
    if group:
        yield from _if_whole(group, True, wanted)


def _if_whole(group: Group, beside_gap: bool, wanted: set[str]) -> Iterator[Group]:
    if not beside_gap or wanted <= {message.topic for message in group}:
        yield group


def _write_recording(found: Salvage, out: Path, begin: Mapping[str, str], ledger: Ledger) -> None:
    known = {topic.name: topic for topic in found.topics.values()}
    own = {topic.name for topic in schemas.TOPICS}
    needed = {topic.name for topic in NEEDED}
    rig: Rig | None = None
    writer = recording.RecordingWriter(out, source=begin.get("source", ""), extra=_fields(begin))
    with writer:
        for group in _groups(found, ledger, own & known.keys()):
            messages = {message.topic: message for message in group if message.topic in own}
            try:
                if not needed <= messages.keys():
                    raise InputError(f"frame {group[0].sequence} lacks messages")
                frame = decode_frame(found.path, messages, rig, truth=True)
                others = [(known[m.topic], bytes(m.data)) for m in group if m.topic not in own]
                writer.add(frame, others)
            except InputError as error:
                ledger.lose(str(error))
                continue
            rig = frame.rig
            ledger.keep(group)
        ledger.digest = writer.digest


def _write_perception(found: Salvage, out: Path, begin: Mapping[str, str], ledger: Ledger) -> None:
    topics = {topic.name for topic in perception_schemas.TOPICS}
    moved = {**_fields(begin), "recording": _moved(begin.get("recording", ""), found.path, out)}
    last = -1
    with perception.PerceptionWriter.going_on(out, moved) as writer:
        for group in _groups(found, ledger, topics):
            try:
                _check_rising(group, last)
                writer.add(perception.frame_of(found.path, {m.topic: m for m in group}, writer.dimensions))
            except InputError as error:
                ledger.lose(str(error))
                continue
            last = group[0].sequence
            ledger.keep(group)
        if not writer.frames:
            raise InputError(f"{found.path}: no frame is whole; run perceive again")
        ledger.digest = writer.digest


def _write_trace(found: Salvage, out: Path, begin: Mapping[str, str], ledger: Ledger) -> None:
    known = {topic.name: topic for topic in found.topics.values()}
    needed = {trace_schemas.DECISIONS.name, trace_schemas.VOXELS.name}
    frames, last = 0, -1
    with McapWriter(out) as writer:
        begin = {**_fields(begin), "run": _moved_run(begin.get("run", "{}"), found.path, out)}
        writer.metadata(trace.BEGIN_METADATA, begin)
        for group in _groups(found, ledger, needed):
            try:
                _check_rising(group, last)
                ledger.digest = _link(ledger.digest, found.path, group)
            except InputError as error:
                ledger.lose(str(error))
                continue
            for message in group:
                writer.add(known[message.topic], message.sequence, message.log_time, bytes(message.data))
            frames, last = frames + 1, group[0].sequence
            ledger.keep(group)
        if not frames:
            raise InputError(f"{found.path}: no frame is whole; run replay again")
        writer.metadata(trace.METADATA, {**begin, "frames": str(frames), "digest": ledger.digest})


def _link(previous: str, path: Path, group: Group) -> str:
    """The trace's digest with this frame, which must be readable."""
    step = trace.frame_of(path, group)
    try:
        decisions = [{name: row[name] for name in _DECISION if name in row} for row in step.decisions]
        return trace.decision_link(previous, step.frame, decisions)
    except (TypeError, ValueError) as error:
        raise InputError(f"frame {step.frame}: its decisions cannot be read ({error})") from error


def _check_rising(group: Group, last: int) -> None:
    if group[0].sequence <= last:
        raise InputError(f"frame {group[0].sequence} comes after frame {last}")


def _fields(begin: Mapping[str, str]) -> dict[str, str]:
    """Of the record at the end those that the one at the beginning has, too: what it counts is counted anew."""
    return {name: value for name, value in begin.items() if name not in _COUNTED}


_DECISION = tuple(one.name for one in fields(Decision))
_COUNTED = {
    *("frames", "first", "last", "seconds", "path_length_m", "has_color", "has_truth", "dropped", "digest"),
    *("masks", "kinds"),
}


def _moved(path: str, old: Path, new: Path) -> str:
    """A path relative to the old file's folder as one relative to the new file's."""
    return Path(os.path.relpath(old.resolve().parent / path, new.resolve().parent)).as_posix()


def _moved_run(text: str, old: Path, new: Path) -> str:
    """What a trace says of its run, with the paths of its sources moved."""
    try:
        run: dict[str, Any] = json.loads(text)
        sources = {name: [_moved(path, old, new), digest] for name, (path, digest) in run.get("sources", {}).items()}
    except (ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{old}: what it says of its run cannot be read ({error}); replay again") from error
    return json.dumps({**run, "sources": sources}, sort_keys=True)


KINDS: dict[str, tuple[Any, Callable[[Salvage, Path, Mapping[str, str], Ledger], None]]] = {
    "recording": (recording, _write_recording),
    "perception": (perception, _write_perception),
    "trace": (trace, _write_trace),
}
"""Each kind with the module of its metadata and what writes it anew."""
