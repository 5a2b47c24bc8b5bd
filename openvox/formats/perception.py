"""Perception files: `STEM.perception.mcap` with the masks, captions and embeddings of a recording's frames.

A file of its own, since to read one small topic out of chunks full of pictures takes as long as reading all. A frame
without messages was not looked at; one whose messages are empty was, and nothing was found.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from openvox import __version__
from openvox.core.digest import START, canonical_json, chain
from openvox.core.errors import InputError
from openvox.core.parameters import Value
from openvox.core.types import MASK_KINDS, Mask
from openvox.formats import perception_schemas as schemas
from openvox.formats.detections import Box
from openvox.formats.growing import growing_messages, growing_metadata, is_unfinished
from openvox.formats.mcap_io import McapWriter, Message, read_messages, read_metadata
from openvox.formats.recording import RecordingInfo

FORMAT_VERSION = 1
METADATA = "openvox.perception"
BEGIN_METADATA = f"{METADATA}.begin"
"""What is known before the first frame; all that an unfinished file has."""
SUFFIX = ".perception.mcap"


@dataclass(frozen=True)
class PerceptionInfo:
    """What a perception file says about itself."""

    path: Path
    recording_digest: str
    recording: str
    """Path of the recording, relative to the perception file's folder."""
    encoder: str
    dimensions: int
    frames: int
    """That were looked at."""
    masks: int
    kinds: Mapping[str, int]
    """Number of masks of each kind."""
    digest: str
    """Chain over the content of all frames."""
    stages: tuple[Mapping[str, Any], ...]
    """Det, SegCap, Enc: role, name, parameters, model_digest."""
    parameters: Mapping[str, Value]
    """Of all stages together."""
    metadata: Mapping[str, str]
    """The record `openvox.perception` as it is."""


@dataclass(frozen=True, eq=False)
class FrameMasks:
    """What was found in a frame that was looked at; masks have their embeddings."""

    index: int
    stamp_ns: int
    frame_digest: str
    masks: tuple[Mask, ...]
    size: tuple[int, int]
    """(height, width) of the colour image."""
    boxes: tuple[Box, ...] = ()
    """Of the detector; empty where they were not asked for, or there is none."""
    stage_digests: tuple[str, str, str] = field(default=("", "", ""))
    """What Det, SegCap and Enc depended on, besides the frame."""


class PerceptionWriter:
    """Writes a perception file, complete or not at all; a context manager. The same frames give the same bytes.

    recording: a path where it is still being written: an error then leaves what there is as NAME.partial. stages: of
    each role, name, parameters and model_digest. Raises OutputError if the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        recording: RecordingInfo | Path,
        *,
        stages: Sequence[Mapping[str, Any]],
        encoder: str,
        dimensions: int,
    ) -> None:
        begin = begin_metadata(path, recording, stages, encoder, dimensions)
        self._open(path, begin, encoder, dimensions, live=isinstance(recording, Path))

    @classmethod
    def going_on(cls, path: Path, begin: Mapping[str, str]) -> Self:
        """A writer of the same frames again, as `openvox.perception.begin` describes them. Raises InputError."""
        writer = cls.__new__(cls)
        try:
            writer._open(path, dict(begin), begin["encoder"], int(begin["dimensions"]))
        except (KeyError, ValueError) as error:
            raise InputError(f"{path}: its metadata {BEGIN_METADATA} cannot be read ({error!r})") from error
        return writer

    def _open(self, path: Path, begin: dict[str, str], encoder: str, dimensions: int, live: bool = False) -> None:
        self.path, self._begin = path, begin
        self._encoder, self.dimensions = encoder, dimensions
        self._file = McapWriter(path, resumable=True, live=live)
        self._tally = _Tally(dimensions)

    @property
    def frames(self) -> int:
        """Added so far."""
        return self._tally.frames

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
        with ExitStack() as stack:
            stack.push(self._stack.__exit__)
            if error is not None:
                raise error
            self._file.metadata(METADATA, {**self._begin, **self._tally.record()})

    def add(self, found: FrameMasks) -> None:
        """The next frame that was looked at; frame numbers rise, and every mask has its embedding."""
        vectors = _vectors(found, self.dimensions)
        stamp, (det, segcap, enc) = found.stamp_ns, ((found.frame_digest, stage) for stage in found.stage_digests)
        for topic, data in (
            (schemas.DETECTIONS, schemas.encode_detections(stamp, det, found.boxes)),
            (schemas.MASKS, schemas.encode_masks(stamp, segcap, found.size, found.masks)),
            (schemas.EMBEDDINGS, schemas.encode_embeddings(stamp, enc, self._encoder, vectors)),
            (schemas.ANNOTATIONS, schemas.encode_annotations(stamp, found.masks)),
        ):
            self._file.add(topic, found.index, stamp, data)
        self._tally.add(found, vectors)

    def skip(self, stamp_ns: int) -> None:
        """A frame that is not looked at: nothing is written, but what waits to be written does not wait longer."""
        self._file.pass_time(stamp_ns)

    def describe(self, **more: str) -> None:
        """Metadata that are known only now; the record at the end has them."""
        self._begin = self._begin | more

    def info(self) -> PerceptionInfo:
        """What was written; only after the block has ended."""
        return perception_info(self.path)


def begin_metadata(
    path: Path, recording: RecordingInfo | Path, stages: Sequence[Mapping[str, Any]], encoder: str, dimensions: int
) -> dict[str, str]:
    """What a file at `path` says of itself before its first frame. recording: a path where it is still written."""
    of, digest = (recording, "") if isinstance(recording, Path) else (recording.path, recording.digest)
    return {
        "format_version": str(FORMAT_VERSION),
        "openvox_version": __version__,
        "recording": Path(os.path.relpath(of.resolve(), path.parent.resolve())).as_posix(),
        "recording_digest": digest,
        "encoder": encoder,
        "dimensions": str(dimensions),
        "stages": _json(list(stages)),
    }


@dataclass
class _Tally:
    """What is counted while frames are written, or found in an unfinished file."""

    dimensions: int
    digest: str = START
    frames: int = 0
    masks: int = 0
    kinds: Counter[str] = field(default_factory=Counter)

    def add(self, found: FrameMasks, vectors: NDArray[np.float32]) -> None:
        """The next frame with its masks' vectors."""
        self.digest = chain(self.digest, *_content(found), np.ascontiguousarray(vectors, "<f4").tobytes())
        self.frames, self.masks = self.frames + 1, self.masks + len(found.masks)
        self.kinds.update(mask.kind for mask in found.masks)

    def record(self) -> dict[str, str]:
        """As the metadata at the end have it."""
        counts = {name: self.kinds[name] for name in MASK_KINDS if self.kinds[name]}
        numbers = {"frames": str(self.frames), "masks": str(self.masks), "kinds": _json(counts)}
        return {**numbers, "digest": self.digest}


def _vectors(found: FrameMasks, dimensions: int) -> NDArray[np.float32]:
    """(masks, dimensions)."""
    vectors = np.zeros((len(found.masks), dimensions), np.float32)
    for row, mask in zip(vectors, found.masks, strict=True):
        assert mask.embedding is not None, f"frame {found.index}: a mask without embedding"
        row[:] = mask.embedding
    return vectors


def _content(found: FrameMasks) -> Iterator[bytes]:
    """The bytes of a frame that the file's digest is made of, embeddings apart."""
    yield canonical_json(
        [
            [found.index, found.frame_digest, found.size],
            [[box.corners, box.score, box.label] for box in found.boxes],
            [
                [m.box, m.score, m.label, m.caption, m.caption_score, m.named, m.kind, *m.alternatives]
                for m in found.masks
            ],
        ]
    )
    for mask in found.masks:
        yield mask.bits.tobytes()


def perception_info(path: Path) -> PerceptionInfo:
    """What the perception file says about itself; of an unfinished one what its whole frames say. Raises InputError."""
    record = _counted_record(path) if is_unfinished(path) else read_metadata(path, METADATA, newest=FORMAT_VERSION)
    try:
        stages = tuple(json.loads(record["stages"]))
        return PerceptionInfo(
            path=path,
            recording_digest=record["recording_digest"],
            recording=record["recording"],
            encoder=record["encoder"],
            dimensions=int(record["dimensions"]),
            frames=int(record["frames"]),
            masks=int(record["masks"]),
            kinds=dict(json.loads(record["kinds"])),
            digest=record["digest"],
            stages=stages,
            parameters={name: value for stage in stages for name, value in stage["parameters"].items()},
            metadata=record,
        )
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: its metadata {METADATA} cannot be read ({error!r}); run perceive again") from error


def _counted_record(path: Path) -> dict[str, str]:
    """As the metadata at the end of an unfinished file would be, had it been finished here."""
    begin = growing_metadata(path, BEGIN_METADATA, newest=FORMAT_VERSION)
    tally = _Tally(int(begin.get("dimensions", "0")))
    for found in read_unfinished(path):
        tally.add(found, _vectors(found, tally.dimensions))
    return {**begin, **tally.record()}


def read_masks(
    path: Path, *, start: int | None = None, end: int | None = None, boxes: bool = False
) -> Iterator[FrameMasks]:
    """The frames that were looked at, from `start` to before `end` (frame numbers), ascending.

    boxes: also those of the detector. CRCs are checked; read to its end, the file must hold as many frames as it says.
    Raises InputError."""
    info = perception_info(path)
    topics = {schemas.MASKS.name, schemas.EMBEDDINGS.name, *([schemas.DETECTIONS.name] if boxes else [])}
    count = 0
    whole = _frames(path, read_messages(path, topics, from_sequence=start or 0), len(topics))
    unfinished = (found for found in read_unfinished(path) if found.index >= (start or 0))
    for found in unfinished if is_unfinished(path) else whole:
        if end is not None and found.index >= end:
            return
        _check_embeddings(path, found, info.dimensions)
        yield found
        count += 1
    if start is None and count != info.frames and not is_unfinished(path):  # more may have come meanwhile
        raise InputError(f"{path} holds {count} frames, its metadata say {info.frames}; run perceive again")


def _check_embeddings(path: Path, found: FrameMasks, dimensions: int) -> None:
    """Every mask has one of so many numbers and of unit length."""
    if any(mask.embedding is None or len(mask.embedding) != dimensions for mask in found.masks):
        raise InputError(f"{path}, frame {found.index}: a vector has not {dimensions} numbers; run perceive again")
    for m, mask in enumerate(found.masks):
        if not abs(float(np.linalg.norm(mask.embedding)) - 1) < 1e-3:  # type: ignore[arg-type]  # NaN fails, too
            raise InputError(
                f"{path}, frame {found.index}, mask {m}: its embedding is not of unit length; run perceive again"
            )


def interrupted(path: Path, *, forget: bool = False) -> Path | None:
    """What an interrupted writing of `path` has left, moved out of the way of the next; None if there is nothing.

    forget: it is of no use and is removed."""
    partial, kept = (path.with_name(path.name + suffix) for suffix in (".partial", ".earlier.partial"))
    with suppress(OSError):
        # Of two, the larger has more of the same frames: each run began with what the one before had left.
        if partial.exists() and not (kept.exists() and kept.stat().st_size > partial.stat().st_size):
            os.replace(partial, kept)
        if forget:
            kept.unlink(missing_ok=True)
    return kept if kept.exists() else None


def read_unfinished(path: Path) -> Iterator[FrameMasks]:
    """The whole frames, with boxes, of a file whose writing was interrupted: up to the first damage, and no error."""
    topics = {schemas.DETECTIONS.name, schemas.MASKS.name, schemas.EMBEDDINGS.name}
    with suppress(InputError):
        yield from _frames(path, growing_messages(path, topics), len(topics))


def _frames(path: Path, messages: Iterable[Message], wanted: int) -> Iterator[FrameMasks]:
    """Frames of so many messages each."""
    group: dict[str, Message] = {}
    last = -1
    for message in messages:
        if message.sequence < last or message.topic in group:
            raise InputError(f"{path}: the message on {message.topic} of frame {message.sequence} is out of place")
        group[message.topic], last = message, message.sequence
        if len(group) == wanted:
            yield _frame(path, group)
            group, last = {}, last + 1
    if group:
        raise InputError(f"{path}: the last frame lacks messages; run perceive again")


def frame_of(path: Path, messages: Mapping[str, Message], dimensions: int) -> FrameMasks:
    """A frame of its messages by topic, its embeddings checked. Raises InputError."""
    found = _frame(path, messages)
    _check_embeddings(path, found, dimensions)
    return found


def _frame(path: Path, messages: Mapping[str, Message]) -> FrameMasks:
    """A frame of its messages by topic; boxes where they are among them."""
    head = messages[schemas.MASKS.name]
    try:
        if any(message.sequence != head.sequence for message in messages.values()):
            raise InputError("a message is missing")
        (frame_digest, segcap), size, fields = schemas.decode_masks(head.data)
        (_, enc), vectors = schemas.decode_embeddings(messages[schemas.EMBEDDINGS.name].data)
        if len(vectors) != len(fields):
            raise InputError(f"{len(fields)} masks have {len(vectors)} vectors")
        masks = tuple(Mask(**mask, embedding=vector) for mask, vector in zip(fields, vectors, strict=True))
        det, found = "", tuple[Box, ...]()
        if schemas.DETECTIONS.name in messages:
            (_, det), found = schemas.decode_detections(messages[schemas.DETECTIONS.name].data)
    except (InputError, DecodeError) as error:
        raise InputError(f"{path}, frame {head.sequence}: {error}; run perceive again") from error
    return FrameMasks(head.sequence, head.log_time, frame_digest, masks, size, found, (det, segcap, enc))


def _json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"))
