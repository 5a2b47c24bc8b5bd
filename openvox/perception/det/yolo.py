"""Det from the ONNX file of a YOLO detector, open or closed set (YOLO-World, YOLOE, YOLOv5 to v11, YOLO-NAS and kin).

The vocabulary is what was baked in at export: words from a text file, or from the file's own metadata.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from openvox.core.errors import InputError
from openvox.core.parameters import Value, parameter
from openvox.core.types import Frame
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.det.boxes import letterboxed, suppressed
from openvox.perception.det.yolo_outputs import EXPECTED, decoded, padding
from openvox.perception.onnx import Model
from openvox.perception.stage import stage_digest

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

MOST_WORDS = 100_000
CANDIDATES = 3000
"""So many of the best boxes are compared with each other."""
VERSION = 1


@dataclass(frozen=True, kw_only=True)
class YoloOptions:
    """What the TOML file may say in [det]."""

    file: str = parameter("", "", why="the ONNX file")
    words: str = parameter(
        "", "", why="a text file, one word a line by class number; else those in the model's metadata"
    )
    score: float = parameter(0.3, "score", 0.0, 1.0, why="less sure boxes are more often wrong than right")
    top_k: int = parameter(100, "boxes", 1, 10_000, why="at most so many a frame, the best")
    overlap: float = parameter(0.7, "IoU", 0.0, 1.0, why="of two boxes of one word that overlap more the better stays")
    side: int = parameter(
        640, "px", 32, 4096, why="of the square that pictures are put into, if the file leaves it open"
    )


class Yolo:
    """Boxes above a score, the best of those that overlap, with the words of the vocabulary."""

    Options = YoloOptions
    name = "yolo"

    def __init__(self, options: YoloOptions, setting: Setting) -> None:
        words = [setting.file("det.words", options.words)] if options.words else []
        self._options = options
        self._model = Model.of_user(setting.file("det.file", options.file), *words)
        self.device, self.model_digest = self._model.device, self._model.digest
        self._height, self._width = _input_size(self._model, options.side)
        self._words = _read_words(words[0]) if words else _words_inside(self._model)
        self._find(np.zeros((self._height, self._width, 3), np.uint8))  # says at once what does not fit
        numbers = {"det.score": options.score, "det.top_k": options.top_k, "det.overlap": options.overlap}
        self.parameters: Mapping[str, Value] = {**numbers, "det.file": self._model.file.name}
        size = [f"{self._width}x{self._height}", self.device]
        self._digest = stage_digest(self.name, VERSION, numbers, self.model_digest, *size)

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def looks_at(self, frame: Frame) -> bool:
        """Always; in a frame without colour there is nothing to find."""
        return True

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """In colour pixels, best first. Raises InputError if the model's numbers are none that boxes can have."""
        return self._find(decode_color(frame)) if frame.color else ()

    def _find(self, rgb: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> tuple[Box, ...]:
        options, model = self._options, self._model
        picture, place = letterboxed(rgb, self._height, self._width, padding(list(model.outputs)))
        outputs = model.run_all({next(iter(model.inputs)): picture})
        corners, score, kind, alone = decoded(model, outputs, (self._height, self._width), len(self._words))
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


def _input_size(model: Model, side: int) -> tuple[int, int]:
    """(height, width) of the one picture that goes in. Raises InputError."""
    if len(model.inputs) == 2 and any("txt" in name or "text" in name for name in model.inputs):
        raise model.refused("one input: vectors of words cannot be given here; export with the vocabulary baked in")
    kind, shape = next(iter(model.inputs.values()), ("", []))
    if len(model.inputs) != 1 or len(shape) != 4 or shape[1] != 3 or kind not in ("tensor(float)", "tensor(float16)"):
        raise model.refused(EXPECTED)
    if isinstance(shape[0], int) and shape[0] != 1:
        raise model.refused("one picture at a time, [1,3,height,width]; export with batch size 1")
    height, width = (length if isinstance(length, int) else side for length in shape[2:])
    return height, width


def _read_words(path: Path) -> list[str]:
    try:
        return _checked([line.strip() for line in path.read_text(encoding="utf-8").splitlines()], path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text, one word a line ({error})") from None


def _words_inside(model: Model) -> list[str]:
    """Metadata `names`: as Ultralytics writes them, a Python dict; or one a line."""
    text = model.metadata.get("names", "")
    try:
        names = ast.literal_eval(text) if text[:1] in ("{", "[") else text.split("\n")
        words = [str(names[i]) for i in range(len(names))]
    except (ValueError, SyntaxError, KeyError, TypeError, MemoryError, RecursionError):
        words = []
    if not any(words):
        raise InputError(
            f"{model.file} holds no names of its classes; give a text file, one a line: [det] words = FILE"
        )
    return _checked(words, model.file)


def _checked(words: Sequence[str], path: Path) -> list[str]:
    if not any(words) or len(words) > MOST_WORDS:
        raise InputError(
            f"{path}: {len(words)} words; expected 1 to {MOST_WORDS}, one a line, in the order of the classes"
        )
    return list(words)
