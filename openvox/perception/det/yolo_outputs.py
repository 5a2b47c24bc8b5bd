"""The outputs that exporters of YOLO detectors write, told apart by names and shapes, as boxes, scores and classes.

| outputs | who writes them |
|---|---|
| `scores` [1,n,c], `boxes` [1,n,4] | YOLO-World's own export without NMS, the NanoDet here |
| `num_dets`, `boxes` [1,n,4], `scores` [1,n], `labels` [1,n], or without the 1 | YOLO-World's own with NMS |
| one, [1,4+c,n], centres and sizes | Ultralytics: YOLOv8 and later, YOLOv8-World |
| one, [1,4+c+k,n], and another, [1,k,h,w], for masks that are not used | their segmenters: YOLOv8-seg, YOLOE |
| one, [1,n,6], corners, score, class | the same with `nms=True`, YOLOv10 |
| one, [1,n,5+c], centres, sizes, objectness | YOLOv5, YOLOv7 |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.perception.onnx import Model

EXPECTED = (
    "the input images float[1,3,h,w] and, for c words, boxes [1,n,4] with scores [1,n,c]; or boxes, scores [1,n] and "
    "labels [1,n]; or one output [1,4+c,n], [1,n,6] or [1,n,5+c]"
)
Floats = NDArray[np.float32]
Outputs = Mapping[str, NDArray[Any]]
Found = tuple[Floats, Floats, NDArray[np.int64], bool]
"""(n, 4) corners in the model's picture, (n,) scores, (n,) classes, and whether overlapping ones were taken out."""


def decoded(model: Model, outputs: Outputs, size: tuple[int, int], words: int) -> Found:
    """What the model found. size: (height, width) of its picture. Raises InputError, naming what does not fit."""
    if {"boxes", "scores", "labels"} <= outputs.keys():
        found = _finished(model, outputs)
    elif {"boxes", "scores"} <= outputs.keys():
        found = _named(model, outputs, words)
    else:
        found = _single(model, _rows(model, list(outputs.values())), size, words)
    corners, scores, kinds, alone = found
    if not (np.isfinite(corners).all() and np.isfinite(scores).all()):
        raise InputError(f"{model.file}: boxes or scores are not finite numbers; export it again")
    if len(scores) and not (scores.min() >= -1e-3 and scores.max() <= 1 + 1e-3):
        raise InputError(
            f"{model.file}: scores from {scores.min():.3g} to {scores.max():.3g}; expected 0 to 1: export with the "
            "sigmoid inside"
        )
    unknown = kinds[(kinds < 0) | (kinds > words)]  # the one after the last word is padding of the export
    if len(unknown):
        raise InputError(f"{model.file}: class {unknown[0]} of {words} words; give the words it was exported with")
    return corners, scores.clip(0, 1), kinds, alone


def _finished(model: Model, outputs: Outputs) -> Found:
    boxes, scores, labels = (outputs[name] for name in ("boxes", "scores", "labels"))
    if boxes.shape[-1:] != (4,) or not boxes.shape[:-1] == scores.shape == labels.shape:
        raise model.refused(EXPECTED)
    count = int(outputs["num_dets"].reshape(-1)[0]) if "num_dets" in outputs else scores.size
    corners, scores = boxes.reshape(-1, 4).astype(np.float32), scores.reshape(-1).astype(np.float32)
    return corners[:count], scores[:count], labels.reshape(-1).astype(np.int64)[:count], True


def _named(model: Model, outputs: Outputs, words: int) -> Found:
    boxes, scores = (np.asarray(outputs[name][0], np.float32) for name in ("boxes", "scores"))
    if boxes.ndim != 2 or boxes.shape[1] != 4 or scores.ndim != 2 or len(scores) != len(boxes):
        raise model.refused(EXPECTED)
    if (boxes[:, 2:] < boxes[:, :2]).any(1).mean() > 0.1:
        raise InputError(f"{model.file}: boxes are distances, not corners; export with the box decoder inside")
    return boxes, *_best(model, scores, words), False


def _rows(model: Model, outputs: Sequence[NDArray[Any]]) -> Floats:
    """The rows of boxes, without the last k, which a segmenter's second output, [1,k,h,w], would make masks of."""
    rows = [np.asarray(output[0], np.float32) for output in outputs if output.ndim == 3]
    if len(rows) != 1:
        raise model.refused(EXPECTED)
    return rows[0][: len(rows[0]) - sum(output.shape[1] for output in outputs if output.ndim == 4)]


def _single(model: Model, rows: Floats, size: tuple[int, int], words: int) -> Found:
    cells = sum((size[0] // step) * (size[1] // step) for step in (8, 16, 32))
    objectness = rows.shape[1] == 5 + words
    if rows.shape[1] == 6 and not (objectness and len(rows) == 3 * cells):
        return rows[:, :4], rows[:, 4], rows[:, 5].astype(np.int64), True
    if len(rows) == 4 + words:
        return _corners(rows[:4].T), *_best(model, rows[4:].T, words), False
    if objectness and len(rows) != cells:
        return _corners(rows[:, :4]), *_best(model, rows[:, 5:] * rows[:, 4:5], words), False
    raise model.refused(
        f"{EXPECTED}; the output came out as [1,{rows.shape[0]},{rows.shape[1]}], "
        f"as [1,4+c,n] that is for {max(0, len(rows) - 4)} words, and there are {words} words"
        + (", and a row a cell (YOLOX) is not decoded here" if objectness else "")
    )


def _corners(boxes: Floats) -> Floats:
    """x, y of the centre, width and height as x0, y0, x1, y1."""
    half = boxes[:, 2:] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], 1)


def _best(model: Model, scores: Floats, words: int) -> tuple[Floats, NDArray[np.int64]]:
    """The best class of each of (n, c) rows; a class more than words is padding of the export, and no word."""
    classes = scores.shape[1]
    if classes not in (words, words + 1):
        raise model.refused(f"{words} classes, as there are words, not {classes}; give the words it was exported with")
    kinds = scores[:, :words].argmax(1)
    return scores[np.arange(len(scores)), kinds], kinds
