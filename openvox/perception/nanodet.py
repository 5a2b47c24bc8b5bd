"""Det of the front end that comes with openvox: NanoDet-g, boxes with the words of COCO."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.core.parameters import Value
from openvox.core.types import Frame
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.encoder import MODELS
from openvox.perception.onnx import Model
from openvox.perception.parameters import OfflineParameters
from openvox.perception.stage import stage_digest

FOLDER = MODELS / "nanodet_g"
SIDE = 416
VERSION = 1
Floats = NDArray[np.float32]


class NanoDet:
    """Boxes above a score, overlapping ones of the same thing left out; words that stand in no room are dropped."""

    name = "nanodet"

    def __init__(self, parameters: OfflineParameters) -> None:
        self._parameters = parameters
        self._model = Model(FOLDER / "nanodet_g_416_fp16w.onnx", FOLDER / "outdoor_words.json")
        self.model_digest = self._model.digest
        self._words = self._model.metadata["names"].split("\n")
        outdoor = json.loads((FOLDER / "outdoor_words.json").read_text())
        self._indoors = np.array([word not in outdoor for word in self._words])
        self.parameters: Mapping[str, Value] = {"offline.box_score": parameters.box_score}
        self._digest = stage_digest(self.name, VERSION, self.parameters, self.model_digest)

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def looks_at(self, frame: Frame) -> bool:
        """Always; in a frame without colour there is nothing to find."""
        return True

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """In colour pixels, best first."""
        if not frame.color:
            return ()
        rgb = decode_color(frame)
        picture, place = letterboxed(rgb, SIDE)
        boxes, scores = self._model.run(["boxes", "scores"], images=picture)
        kind, score = scores[0].argmax(1), scores[0].max(1)
        keep = (score > self._parameters.box_score) & self._indoors[kind]
        corners = place.undone(boxes[0][keep], rgb.shape[1], rgb.shape[0])
        return tuple(
            Box((x0, y0, x1, y1), float(score[keep][i]), self._words[kind[keep][i]])
            for i in suppressed(corners, score[keep], kind[keep])
            for x0, y0, x1, y1 in [corners[i].tolist()]
            if x1 > x0 and y1 > y0
        )


@dataclass(frozen=True, slots=True)
class Letterbox:
    """How a picture was put into a square: times `scale`, then moved by (left, top) pixels."""

    scale: float
    left: int
    top: int

    def undone(self, corners: Floats, width: int, height: int) -> Floats:
        """(n, 4) boxes of the square in the pixels of the picture, cut at its rim."""
        x0, y0, x1, y1 = corners.T
        columns = (((x - self.left) / self.scale).clip(0, width) for x in (x0, x1))
        rows = (((y - self.top) / self.scale).clip(0, height) for y in (y0, y1))
        (left, right), (top, bottom) = columns, rows
        return np.stack([left, top, right, bottom], 1).astype(np.float32)


def letterboxed(rgb: NDArray[np.uint8], side: int) -> tuple[Floats, Letterbox]:
    """(1, 3, side, side) float32 RGB from 0 to 1, the picture amid a black square, and where it is there."""
    import cv2

    height, width = rgb.shape[:2]
    scale = min(side / height, side / width)
    rows, columns = round(height * scale), round(width * scale)
    top, left = (side - rows) // 2, (side - columns) // 2
    square = np.zeros((side, side, 3), np.float32)
    small = cv2.resize(rgb, (columns, rows), interpolation=cv2.INTER_LINEAR)
    square[top : top + rows, left : left + columns] = small * np.float32(1 / 255)
    return np.ascontiguousarray(square.transpose(2, 0, 1)[None]), Letterbox(scale, left, top)


def suppressed(
    corners: Floats, scores: Floats, kinds: NDArray[np.int64], same: float = 0.5, other: float = 0.8
) -> list[int]:
    """Rows to keep, best first, without boxes that overlap a better one: IoU above `same` if of its kind, else `other`.

    corners: (n, 4) x0, y0, x1, y1. Among equal scores the lower kind comes first, then the box further left."""
    kept: list[int] = []
    for i in np.lexsort((corners[:, 0], kinds, -scores)).tolist():
        limits = (same if kinds[i] == kinds[j] else other for j in kept)
        if all(box_iou(corners[i], corners[j]) <= limit for j, limit in zip(kept, limits, strict=True)):
            kept.append(i)
    return kept


def box_iou(a: Floats, b: Floats) -> float:
    """Common area of two boxes over that of both."""
    sides = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    common = float(np.prod(sides.clip(0)))
    both = float(np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2])) - common
    return common / both if both > 0 else 0.0
