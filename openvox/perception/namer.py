"""Words for regions that no detector named: EfficientNet-Lite0 sees each alone, all around it painted grey."""

from __future__ import annotations

import json
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Mask
from openvox.perception.encoder import MODELS
from openvox.perception.onnx import Model

FOLDER = MODELS / "efficientnet_lite0"
SIDE = 224
GREY = 127
MARGIN = 0.12
BATCH = 8
MOST, LEAST = 8, 0.05
"""So many nouns of a mask are told, none less likely."""


class Namer:
    """An ImageNet classifier whose classes are joined to everyday nouns. Safe to call from several threads."""

    def __init__(self) -> None:
        self._model = Model(FOLDER / "efficientnet_lite0_fp16w.onnx", FOLDER / "indoor_nouns.json")
        self.digest = self._model.digest
        table = {int(number): noun for number, noun in json.loads((FOLDER / "indoor_nouns.json").read_text()).items()}
        self.nouns = sorted(set(table.values()))
        self._classes = np.array(sorted(table))
        self._noun_of = np.array([self.nouns.index(table[number]) for number in self._classes.tolist()])

    def prepare(self) -> None:
        """Loads the model."""
        self._model.load()

    def __call__(self, rgb: NDArray[np.uint8], masks: Sequence[Mask]) -> list[list[tuple[str, float]]]:
        """The likelier nouns of each mask, best first, and their probability among all classes, indoors or not."""
        found = []
        for start in range(0, len(masks), BATCH):
            crops = np.stack([square(rgb, mask) for mask in masks[start : start + BATCH]])
            images = crops.transpose(0, 3, 1, 2).astype(np.float32) * np.float32(1 / 255)
            for row in self._nouns(self._model.run(["logits"], images=np.ascontiguousarray(images))[0]):
                order = np.argsort(-row, kind="stable")[:MOST]
                found.append([(self.nouns[i], float(row[i])) for i in order.tolist() if row[i] >= LEAST])
        return found

    def _nouns(self, logits: NDArray[np.float32]) -> NDArray[np.float64]:
        """(n, nouns) probabilities."""
        weights = np.exp((logits - logits.max(1, keepdims=True)).astype(np.float64))
        weights /= weights.sum(1, keepdims=True)
        sums = np.zeros((len(logits), len(self.nouns)))
        np.add.at(sums.T, self._noun_of, weights[:, self._classes].T)
        return sums


def square(rgb: NDArray[np.uint8], mask: Mask) -> NDArray[np.uint8]:
    """(SIDE, SIDE, 3): the mask in the middle with some room around it; what is not the mask is grey."""
    import cv2

    x0, y0, x1, y1 = mask.box
    side = max(x1 - x0, y1 - y0) * (1 + 2 * MARGIN) + 4
    left, top = round((x0 + x1 - side) / 2), round((y0 + y1 - side) / 2)
    right, bottom = left + round(side), top + round(side)
    crop = np.full((bottom - top, right - left, 3), GREY, np.uint8)
    shown = np.zeros(crop.shape[:2], np.uint8)
    shown[y0 - top : y1 - top, x0 - left : x1 - left] = mask.crop()
    shown = np.asarray(cv2.dilate(shown, np.ones((9, 9), np.uint8)), np.uint8)
    height, width = rgb.shape[:2]
    a, b, c, d = max(0, top), min(height, bottom), max(0, left), min(width, right)
    inside = (slice(a - top, b - top), slice(c - left, d - left))
    crop[inside] = np.where(shown[inside][..., None] > 0, rgb[a:b, c:d], GREY)
    how = cv2.INTER_AREA if len(crop) > SIDE else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(crop, (SIDE, SIDE), interpolation=how), np.uint8)
