"""Det of the front end that comes with openvox: NanoDet-g, boxes with the words of COCO."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from openvox.core.parameters import Value
from openvox.core.types import Frame
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.det.boxes import letterboxed, suppressed
from openvox.perception.encoder import MODELS
from openvox.perception.onnx import Model
from openvox.perception.parameters import OfflineParameters
from openvox.perception.stage import stage_digest

FOLDER = MODELS / "nanodet_g"
SIDE = 416
VERSION = 2


class NanoDet:
    """Boxes above a score, overlapping ones of the same thing left out; words that stand in no room are dropped."""

    name = "nanodet"

    def __init__(self, parameters: OfflineParameters) -> None:
        self._parameters = parameters
        self._model = Model(FOLDER / "nanodet_g_416_fp16w.onnx", FOLDER / "outdoor_words.json")
        self.model_digest = self._model.digest
        self.parameters: Mapping[str, Value] = {"offline.box_score": parameters.box_score}
        self._digest = stage_digest(self.name, VERSION, self.parameters, self.model_digest)

    @cached_property
    def _words(self) -> list[str]:
        return self._model.metadata["names"].split("\n")

    @cached_property
    def _indoors(self) -> NDArray[np.bool_]:
        outdoor = json.loads((FOLDER / "outdoor_words.json").read_text())
        return np.array([word not in outdoor for word in self._words])

    def prepare(self) -> None:
        """Loads the model."""
        self._model.load()

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """In colour pixels, best first."""
        if not frame.color:
            return ()
        rgb = decode_color(frame)
        picture, place = letterboxed(rgb, SIDE, SIDE)
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
