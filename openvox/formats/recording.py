"""Recordings: `STEM.mcap` with colour, depth, calibrations, poses and, if there is any, ground truth.

Topics and messages are in formats.schemas, what makes a frame of them in formats.frames.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from openvox import __version__
from openvox.core.errors import InputError
from openvox.core.types import Frame, Rig
from openvox.formats import schemas
from openvox.formats.ahead import read_ahead
from openvox.formats.frames import NEEDED, check_color, decode_frame, encode_frame
from openvox.formats.growing import (
    Wait,
    final_name,
    growing_messages,
    growing_metadata,
    is_unfinished,
    whole_groups,
)
from openvox.formats.mcap_io import McapWriter, Message, Topic, read_messages, read_metadata, read_topics
from openvox.formats.tally import Numbers, Tally, reasons

FORMAT_VERSION = 1
METADATA = "openvox.recording"
BEGIN_METADATA = "openvox.recording.begin"
"""What is known before the first frame; all that an unfinished file has."""

MAX_STAMP_NS = (1 << 31) * 10**9
"""Stamps end before 2038: ROS counts seconds in 32 bits."""
_TOPICS = frozenset(topic.name for topic in schemas.TOPICS)


@dataclass(frozen=True)
class RecordingInfo:
    """What a recording says about itself."""

    path: Path
    frames: int
    first: int
    """Number of the first frame."""
    last: int
    digest: str
    """Chain over all frames: core.digest.recording_link."""
    source: str
    """Kind of the source: scannet, replica, ..."""
    depth_unit: str
    """Of the source; the recording has millimetres."""
    path_length_m: float
    dropped: Mapping[str, int]
    """Reason to number of frames."""
    categories: Mapping[int, str]
    """Names of the truth's categories; may be empty."""
    rig: Rig
    """Of the first frame."""
    has_color: bool
    has_truth: bool
    seconds: float
    """From the first stamp to the last."""
    origin_m: tuple[int, ...]
    """What ingest subtracted from the source's positions."""
    metadata: Mapping[str, str]
    """The record `openvox.recording` as it is."""


class RecordingWriter:
    """Writes a recording, complete or not at all; a context manager. Memory does not grow with the frames' pixels.

    source: kind of the source. depth_unit: that of the source. extra: further metadata. live: an error leaves what was
    written as NAME.partial. The same frames give the same bytes.
    Raises InputError for a frame that cannot follow the last one, OutputError if the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        *,
        source: str,
        depth_unit: str = "mm",
        categories: Mapping[int, str] | None = None,
        extra: Mapping[str, str] | None = None,
        live: bool = False,
    ):
        self.path = path
        self._begin = {
            "format_version": str(FORMAT_VERSION),
            "openvox_version": __version__,
            "source": source,
            "depth_unit": depth_unit,
            "categories": _json({str(number): name for number, name in sorted((categories or {}).items())}),
            **(extra or {}),
        }
        self._file = McapWriter(path, live=live)
        self._tally = Tally()
        self._last_index = -1
        self._dropped: dict[str, Numbers] = {}

    @property
    def digest(self) -> str:
        """Of the frames added so far."""
        return self._tally.digest

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self._file)
            self._file.metadata(BEGIN_METADATA, self._begin)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            self._finish()

    def add(self, frame: Frame, others: Iterable[tuple[Topic, bytes]] = ()) -> None:
        """The next frame: number and stamp must rise. others: its messages on further topics."""
        self._check(frame)
        for topic, data in (*encode_frame(frame), *others):
            self._file.add(topic, frame.index, frame.stamp_ns, data)
        self._tally.add(frame)
        self._last_index = frame.index

    def drop(self, index: int, reason: str) -> None:
        """Notes that frame `index` of the source is left out; its number stays free."""
        self._check_index(index)
        self._last_index = index
        self._dropped.setdefault(reason, Numbers()).add(index)

    def describe(self, **more: str) -> None:
        """Metadata that are known only now; the record at the end has them."""
        self._begin = self._begin | more

    def info(self) -> RecordingInfo:
        """What was written; only after the block has ended."""
        return recording_info(self.path)

    def _check(self, frame: Frame) -> None:
        where = f"{self.path}, frame {frame.index}"
        self._check_index(frame.index)
        if not 0 <= frame.stamp_ns < MAX_STAMP_NS:
            raise InputError(f"{where}: stamp {frame.stamp_ns} ns; expected seconds between 0 and 2**31")
        last = self._tally.last
        if last is not None and frame.stamp_ns <= last.stamp_ns:
            raise InputError(
                f"{where}: stamp {frame.stamp_ns} ns comes not after the {last.stamp_ns} ns of frame "
                f"{last.index}; stamps must rise"
            )
        try:
            check_color(frame)
        except InputError as error:
            raise InputError(f"{self.path}, {error}") from error

    def _check_index(self, index: int) -> None:
        if not self._last_index < index < 1 << 32:
            raise InputError(
                f"{self.path}: frame {index} follows frame {self._last_index}; "
                "frame numbers must rise and stay below 2**32"
            )

    def _finish(self) -> None:
        if not self._tally.frames:
            raise InputError(f"{self.path}: there is no frame to record{reasons(self._dropped)}")
        dropped = {reason: numbers.summary() for reason, numbers in sorted(self._dropped.items())}
        record = {**self._tally.record(), "dropped": _json(dropped)}
        self._file.metadata(METADATA, self._begin | record)


def recording_info(path: Path) -> RecordingInfo:
    """What the recording says about itself, and its first frame's cameras; of an unfinished one what its whole frames
    say. Raises InputError."""
    record = _counted_record(path) if is_unfinished(path) else _metadata(path)
    first = next(_frames(path, None, None, 1, truth=False), None)
    if first is None:
        raise InputError(f"{path} holds no frame; make it again from its source")
    try:
        dropped = {str(reason): int(entry["count"]) for reason, entry in json.loads(record["dropped"]).items()}
        return RecordingInfo(
            path=path,
            frames=int(record["frames"]),
            first=int(record["first"]),
            last=int(record["last"]),
            digest=record["digest"],
            source=record["source"],
            depth_unit=record["depth_unit"],
            path_length_m=float(record["path_length_m"]),
            dropped=dropped,
            categories=dict(_categories(record["categories"])),
            rig=first.rig,
            has_color=bool(json.loads(record["has_color"])),
            has_truth=bool(json.loads(record["has_truth"])),
            seconds=float(record["seconds"]),
            origin_m=tuple(int(metres) for metres in json.loads(record.get("origin_m", "[0, 0, 0]"))),
            metadata=record,
        )
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: its metadata {METADATA} cannot be read ({error!r}); make it again") from error


def read_frames(
    path: Path, *, start: int | None = None, end: int | None = None, stride: int = 1, ahead: int = 8, truth: bool = True
) -> Generator[Frame, None, None]:
    """The frames of a recording in order, read by a thread that is up to `ahead` frames further on (0: no thread).

    start, end (exclusive) and stride mean frame numbers. truth: False leaves truth images undecoded.
    The file is opened and its end checked at once; an unfinished one (NAME.partial) is read as far as it is whole.
    Raises InputError: here for a cut or foreign file, while iterating for damage further in."""
    if stride < 1:
        raise InputError(f"stride is {stride}; expected 1 or more")
    record = _metadata(path)
    frames = _frames(path, start, end, stride, truth)
    if start is None and end is None and stride == 1 and not is_unfinished(path):
        frames = _counted(path, frames, record)
    return read_ahead(frames, ahead)


def selected(index: int, start: int | None, end: int | None, stride: int) -> bool:
    """True if frame `index` is asked for: from start, before end, every stride-th counted from start."""
    return index >= (start or 0) and (end is None or index < end) and (index - (start or 0)) % stride == 0


def _metadata(path: Path) -> dict[str, str]:
    """The recording's metadata; its topics are checked, too."""
    if not path.exists() and not (is_unfinished(path) and final_name(path).exists()):
        raise InputError(f"there is no file {path}")
    if is_unfinished(path):
        return growing_metadata(path, BEGIN_METADATA, newest=FORMAT_VERSION)
    record = read_metadata(path, METADATA, newest=FORMAT_VERSION)
    topics = read_topics(path)
    for topic in schemas.TOPICS:
        found = topics.get(topic.name)
        if found is None and topic in NEEDED:
            raise InputError(f"{path} has no topic {topic.name}; a recording needs depth, its calibration and /tf")
        if found is not None and (found.message_encoding, found.schema_name) != (
            topic.message_encoding,
            topic.schema_name,
        ):
            raise InputError(
                f"{path}: {topic.name} has {found.schema_name} in {found.message_encoding}; "
                f"expected {topic.schema_name} in {topic.message_encoding}"
            )
    return record


def _counted_record(path: Path) -> dict[str, str]:
    """As the metadata at the end of an unfinished file would be, had it been finished here."""
    begin, tally = _metadata(path), Tally()
    for frame in _frames(path, None, None, 1, truth=True):
        tally.add(frame)
    if not tally.frames:
        raise InputError(f"{path} holds no whole frame yet; record anew, or wait until there is one")
    return {**begin, **tally.record(), "dropped": "{}"}


def following(path: Path, wait: Wait) -> Generator[Frame, None, None]:
    """The frames of a recording that may still be written; `wait` is called at what is its end for now: True = look
    again, False = end. Raises InputError."""
    growing_metadata(path, BEGIN_METADATA, newest=FORMAT_VERSION, wait=wait)
    yield from _decoded(path, whole_groups(_grouped(path, growing_messages(path, _TOPICS, wait))), None, None, 1, True)


def _frames(path: Path, start: int | None, end: int | None, stride: int, truth: bool) -> Iterator[Frame]:
    """Selected frames in file order."""
    if is_unfinished(path):
        groups = whole_groups(_grouped(path, growing_messages(path, _TOPICS)))
    else:
        groups = _grouped(path, read_messages(path, _TOPICS, from_sequence=start or 0))
    return _decoded(path, groups, start, end, stride, truth)


def _decoded(
    path: Path,
    groups: Iterator[Mapping[str, Message]],
    start: int | None,
    end: int | None,
    stride: int,
    truth: bool,
) -> Iterator[Frame]:
    """Selected frames, checked against their predecessors."""
    last = (-1, -1)
    rig: Rig | None = None
    for messages in groups:
        head = next(iter(messages.values()))
        here = (head.sequence, head.log_time)
        if here[0] <= last[0] or here[1] <= last[1]:
            raise InputError(
                f"{path}: frame {here[0]} with stamp {here[1]} ns follows frame {last[0]} with {last[1]} ns; "
                "both must rise"
            )
        last = here
        if end is not None and head.sequence >= end:
            return
        if selected(head.sequence, start, end, stride):
            frame = decode_frame(path, messages, rig, truth)
            rig = frame.rig
            yield frame


def _grouped(path: Path, messages: Iterable[Message]) -> Iterator[Mapping[str, Message]]:
    """The messages of each frame by topic."""
    group: dict[str, Message] = {}
    head: Message | None = None
    for message in messages:
        if head is None or message.sequence != head.sequence:
            if group:
                yield group
            group, head = {}, message
        if message.topic in group or message.log_time != head.log_time:
            raise InputError(
                f"{path}, frame {message.sequence}: {message.topic} comes twice or with another stamp "
                f"({message.log_time} and {head.log_time} ns)"
            )
        group[message.topic] = message
    if group:
        yield group


def _counted(path: Path, frames: Iterator[Frame], record: Mapping[str, str]) -> Iterator[Frame]:
    """The same frames; at the end as many as the metadata say."""
    count = 0
    for frame in frames:
        count += 1
        yield frame
    if record.get("frames") != str(count):
        raise InputError(
            f"{path} holds {count} frames, its metadata say {record.get('frames')}; frames were lost: "
            "make it again from its source"
        )


def _categories(text: str) -> list[tuple[int, str]]:
    return sorted((int(number), str(name)) for number, name in json.loads(text).items())


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"))
