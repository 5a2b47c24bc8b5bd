"""Det from the ONNX file of a YOLO detector, open or closed set: YOLO-World, YOLOE, YOLOv5 to v12 and kin.

The vocabulary is what was baked in at export: words from a text file, or from the file's own metadata.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from openvox.core.parameters import Value, parameter
from openvox.core.types import Frame
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.det.boxes import letterboxed, suppressed
from openvox.perception.det.yolo_model import input_size, padding, read_words, words_inside
from openvox.perception.det.yolo_outputs import decoded
from openvox.perception.onnx import Model
from openvox.perception.stage import stage_digest

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

CANDIDATES = 3000
"""So many of the best boxes are compared with each other."""
VERSION = 2


@dataclass(frozen=True, kw_only=True)
class YoloOptions:
    """What the TOML file may say in [det]."""

    file: str = parameter("", "", why="the ONNX file")
    words: str = parameter("", "", why="a text file, a word a line by class number; else those in the model's file")
    score: float = parameter(0.3, "score", 0.0, 1.0, why="less sure boxes are more often wrong than right")
    top_k: int = parameter(100, "boxes", 1, 10_000, why="at most so many a frame, the best")
    overlap: float = parameter(0.7, "IoU", 0.0, 1.0, why="of two boxes of one word that overlap more the better stays")
    side: int = parameter(640, "px", 32, 4096, why="of the square that pictures are put into, if it is left open")


class Yolo:
    """Boxes above a score, the best of those that overlap, with the words of the vocabulary."""

    Options = YoloOptions
    name = "yolo"

    def __init__(self, options: YoloOptions, setting: Setting) -> None:
        listed = [setting.file("det.words", options.words)] if options.words else []
        self._options = options
        self._listed = [word for path in listed for word in read_words(path)]
        self._model = Model.of_user(setting.file("det.file", options.file), *listed)
        self.model_digest = self._model.digest
        numbers: dict[str, Value] = {
            f"det.{name}": getattr(options, name) for name in ("score", "top_k", "overlap", "side")
        }
        self.parameters: Mapping[str, Value] = {**numbers, "det.file": self._model.file.name}
        self._digest = stage_digest(self.name, VERSION, numbers, self.model_digest, self.device)

    @property
    def device(self) -> str:
        """What the model runs on."""
        return self._model.device

    @cached_property
    def _words(self) -> list[str]:
        return self._listed or words_inside(self._model)

    def prepare(self) -> None:
        """Loads the model and says what does not fit."""
        self._find(np.zeros((48, 64, 3), np.uint8))

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """In colour pixels, best first. Raises InputError if the model's numbers are none that boxes can have."""
        return self._find(decode_color(frame)) if frame.color else ()

    def _find(self, rgb: NDArray[np.uint8]) -> tuple[Box, ...]:
        options, model = self._options, self._model
        height, width = input_size(model, options.side)
        picture, place = letterboxed(rgb, height, width, padding(model))
        outputs = model.run_all({next(iter(model.inputs)): picture})
        corners, score, kind, alone = decoded(model, outputs, (height, width), len(self._words))
        best = np.argsort(-score, kind="stable")[:CANDIDATES]
        best = best[score[best] >= options.score]
        corners, score, kind = place.undone(corners[best], rgb.shape[1], rgb.shape[0]), score[best], kind[best]
        found = []
        for i in suppressed(corners, score, kind, 1.0 if alone else options.overlap, 1.0):
            word = self._words[kind[i]] if kind[i] < len(self._words) else ""
            x0, y0, x1, y1 = corners[i].tolist()
            if word and x1 > x0 and y1 > y0:
                found.append(Box((x0, y0, x1, y1), float(score[i]), word))
        return tuple(found[: options.top_k])
