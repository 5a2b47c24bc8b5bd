"""What a user's own front end hands over: a text file with one JSON object a line, one line a frame.

`{"frame": 12, "detections": [{"box": [x0, y0, x1, y1], "score": 0.81, "label": "chair", "caption": "a grey chair",
"mask": {"size": [h, w], "counts": "<COCO compressed RLE>"}}]}`, colour pixels, x1 and y1 exclusive. Optional per
detection: `embedding` (on all or none, with `"encoder"` on the line), `caption_score`, `named`, `kind`. Fields with
other names are ignored. A line with no detections: looked, nothing found; no line: not looked at.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import MASK_KINDS, Mask
from openvox.formats.masks import decode_rle

MAX_LINE = 1 << 26
"""Bytes of one line; a longer one is no frame's detections."""
MAX_FRAME_PIXELS = 1 << 32
"""Pixels of all masks of a frame together; packed they take an eighth of it in bytes."""
MAX_DIMENSIONS = 1 << 16
MAX_FRAME = (1 << 32) - 1


@dataclass(frozen=True, slots=True)
class Box:
    """What a detector says: corners x0, y0, x1, y1 in colour pixels (x1, y1 exclusive), how sure, and a word."""

    corners: tuple[float, float, float, float]
    score: float
    label: str


@dataclass(frozen=True, slots=True)
class FrameDetections:
    """One line of the file: as many boxes as masks, in its order."""

    frame: int
    boxes: tuple[Box, ...]
    masks: tuple[Mask, ...]


class DetectionFile:
    """An indexed file of detections: where each frame's line is, so that frames can be asked for in any order.

    Opening it reads the file once, a line at a time, and checks frame numbers and encoders; a frame's boxes and masks
    are checked when they are read. Safe to read from several threads. Raises InputError, naming file and line.

    `digest`: SHA-256 of the file's bytes. `encoder`: whose embeddings it holds, "" = none. `frames`: in file order.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.encoder = ""
        self.dimensions = 0
        self._spans: dict[int, tuple[int, int, int]] = {}
        self._described = 0
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}); expected a file of detections") from None
        try:
            self.digest = self._index()
        except BaseException:
            self._file.close()
            raise

    @property
    def frames(self) -> tuple[int, ...]:
        """Frame numbers in the order of the file."""
        return tuple(self._spans)

    def read(self, frame: int, size: tuple[int, int] | None = None) -> FrameDetections:
        """The line of a frame, which must be among `frames`. size: (height, width) of the colour image, if known.

        Raises InputError."""
        line, start, length = self._spans[frame]
        where = f"{self.path}:{line}"
        content = _parsed(os.pread(self._file.fileno(), length, start), where)
        return _frame_detections(frame, content["detections"], size, self.dimensions, f"{where}: frame {frame}")

    def close(self) -> None:
        """Lets go of the file."""
        self._file.close()

    def __enter__(self) -> DetectionFile:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _index(self) -> str:
        digest, start, number = hashlib.sha256(), 0, 0
        while line := self._file.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise InputError(
                    f"{self.path}:{number}: line is longer than {MAX_LINE} bytes; expected one frame a line"
                )
            digest.update(line)
            if line.strip():
                self._enter(_parsed(line, f"{self.path}:{number}"), number, start, len(line))
            start += len(line)
        return digest.hexdigest()

    def _enter(self, content: dict[str, Any], number: int, start: int, length: int) -> None:
        where = f"{self.path}:{number}"
        frame: Any = content.get("frame")
        if not _is_whole(frame) or not 0 <= frame <= MAX_FRAME:
            raise InputError(f"{where}: frame is {_short(frame)}; expected the frame's number, from 0")
        if frame in self._spans:
            raise InputError(f"{where}: frame {frame} comes twice, first in line {self._spans[frame][0]}; give it once")
        self._spans[frame] = (number, start, length)
        detections = content.get("detections")
        if not isinstance(detections, list):
            raise InputError(
                f'{where}: frame {frame}: "detections" is missing or no list; write [] if nothing was found'
            )
        if detections:
            encoder = _encoder_of(content, detections, f"{where}: frame {frame}")
            if self._described and encoder != (self.encoder, self.dimensions):
                raise InputError(
                    f"{where}: frame {frame}: {_words(*encoder)}, line {self._described} has "
                    f"{_words(self.encoder, self.dimensions)}; expected the same on all detections"
                )
            self._described = self._described or number
            self.encoder, self.dimensions = encoder


def read_detections(path: Path) -> Iterator[tuple[int, tuple[Mask, ...], str]]:
    """Frame number, masks and encoder's name ("" = no embeddings) of every line, in the order of the file.

    Raises InputError, one sentence with file, line, frame and mask."""
    with DetectionFile(path) as file:
        for frame in file.frames:
            yield frame, file.read(frame).masks, file.encoder


def _parsed(line: bytes, where: str) -> dict[str, Any]:
    try:
        content = json.loads(line, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else error
        raise InputError(f"{where}: line is no JSON ({reason}); expected one object a line, one line a frame") from None
    if not isinstance(content, dict):
        raise InputError(f"{where}: line is {_short(content)}; expected an object with frame and detections")
    return content


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def _encoder_of(content: dict[str, Any], detections: list[Any], where: str) -> tuple[str, int]:
    """Name of the encoder and number of dimensions of a line's embeddings, ("", 0) where it has none."""
    vectors = [item.get("embedding") for item in detections if isinstance(item, dict)]
    given = [vector is not None for vector in vectors]
    if not any(given):
        return "", 0
    if not all(given):
        raise InputError(f"{where}, mask {given.index(False)}: embedding is missing; give it on all detections or none")
    encoder = content.get("encoder")
    if not isinstance(encoder, str) or not encoder:
        raise InputError(
            f'{where}: detections have embeddings, but the line no "encoder"; name the encoder they are of'
        )
    if not isinstance(vectors[0], list) or not 0 < len(vectors[0]) <= MAX_DIMENSIONS:
        raise InputError(
            f"{where}, mask 0: embedding is {_short(vectors[0])}; expected a list of 1 to {MAX_DIMENSIONS} numbers"
        )
    return encoder, len(vectors[0])


def _words(encoder: str, dimensions: int) -> str:
    return f"embeddings of {encoder} with {dimensions} dimensions" if encoder else "no embeddings"


def _frame_detections(
    frame: int, detections: list[Any], size: tuple[int, int] | None, dimensions: int, where: str
) -> FrameDetections:
    sizes = [_size(item, f"{where}, mask {i}") for i, item in enumerate(detections)]
    expected, of = (size, "the colour image") if size else (sizes[0] if sizes else (0, 0), "mask 0")
    for i, (height, width) in enumerate(sizes):
        if (height, width) != expected:
            raise InputError(
                f"{where}, mask {i}: mask is {width}x{height}, {of} {expected[1]}x{expected[0]}; "
                "export masks at the colour image's size"
            )
    if len(sizes) * expected[0] * expected[1] > MAX_FRAME_PIXELS:
        raise InputError(f"{where}: {len(sizes)} masks of {expected[1]}x{expected[0]} pixels are too many for a frame")
    boxes = tuple(_box(item, expected, f"{where}, mask {i}") for i, item in enumerate(detections))
    masks = tuple(
        _mask(item, boxes[i], expected, dimensions, f"{where}, mask {i}") for i, item in enumerate(detections)
    )
    return FrameDetections(frame, boxes, masks)


def _size(item: Any, where: str) -> tuple[int, int]:
    mask = item.get("mask") if isinstance(item, dict) else None
    size = mask.get("size") if isinstance(mask, dict) else None
    if not (isinstance(size, list) and len(size) == 2 and all(_is_whole(side) and side > 0 for side in size)):
        raise InputError(f"{where}: mask size is {_short(size)}; expected [height, width] in pixels")
    return size[0], size[1]


def _box(item: dict[str, Any], size: tuple[int, int], where: str) -> Box:
    corners = item.get("box")
    if not (isinstance(corners, list) and len(corners) == 4 and all(_is_number(value) for value in corners)):
        raise InputError(f"{where}: box is {_short(corners)}; expected [x0, y0, x1, y1]")
    x0, y0, x1, y1 = (float(value) for value in corners)
    if not (0 <= x0 <= x1 <= size[1] and 0 <= y0 <= y1 <= size[0]):
        raise InputError(
            f"{where}: box {corners} does not lie within the mask's {size[1]}x{size[0]} pixels; "
            "expected [x0, y0, x1, y1] with x1 and y1 exclusive"
        )
    return Box((x0, y0, x1, y1), _share(item, "score", None, where), _text(item, "label", where))


def _mask(item: dict[str, Any], box: Box, size: tuple[int, int], dimensions: int, where: str) -> Mask:
    counts = item["mask"].get("counts")
    if not isinstance(counts, str):
        raise InputError(f"{where}: mask counts are {_short(counts)}; expected the text of a COCO compressed RLE")
    kind, named = item.get("kind", "object"), item.get("named", True)
    if kind not in MASK_KINDS:
        raise InputError(f"{where}: kind is {_short(kind)}; expected one of {', '.join(MASK_KINDS)}")
    if not isinstance(named, bool):
        raise InputError(f"{where}: named is {_short(named)}; expected true or false")
    try:
        bitmap = decode_rle(counts, *size)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return Mask.from_bitmap(
        bitmap,
        score=box.score,
        label=box.label,
        caption=_text(item, "caption", where),
        caption_score=_share(item, "caption_score", 1.0, where),
        named=named,
        kind=kind,
        embedding=_embedding(item["embedding"], dimensions, where) if dimensions else None,
    )


def _embedding(values: Any, dimensions: int, where: str) -> NDArray[np.float32]:
    if not (isinstance(values, list) and len(values) == dimensions and all(_is_number(value) for value in values)):
        raise InputError(f"{where}: embedding is {_short(values)}; expected {dimensions} numbers, as on the others")
    vector = np.array(values, np.float64)
    length = math.sqrt(math.fsum(value * value for value in vector.tolist()))
    if not (0.0 < length < math.inf):
        raise InputError(f"{where}: embedding has length {length:g}; expected a direction in finite numbers")
    return (vector / length).astype(np.float32)


def _share(item: dict[str, Any], key: str, default: float | None, where: str) -> float:
    value: Any = item.get(key, default)
    if not _is_number(value) or not 0.0 <= value <= 1.0:
        raise InputError(f"{where}: {key} is {_short(value)}; expected a number between 0 and 1")
    return float(value)


def _text(item: dict[str, Any], key: str, where: str) -> str:
    value = item.get(key)
    if not isinstance(value, str) or any("\ud800" <= character <= "\udfff" for character in value):
        raise InputError(f"{where}: {key} is {_short(value)}; expected a text")
    return value


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 1 << 63


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300


def _short(value: Any) -> str:
    """A value as it may stand in a sentence."""
    if value is None:
        return "missing"
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."
