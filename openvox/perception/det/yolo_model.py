"""What a YOLO detector's file says of itself: the size of its picture, what is around it, the words of its classes."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from pathlib import Path

from openvox.core.errors import InputError
from openvox.perception.det.yolo_outputs import EXPECTED
from openvox.perception.onnx import Model

GREY = 114
MOST = 100_000


def input_size(model: Model, side: int) -> tuple[int, int]:
    """(height, width) of the one picture that goes in, `side` where that is left open. Raises InputError."""
    inputs = model.inputs
    if len(inputs) == 2 and any("txt" in name or "text" in name for name in inputs):
        raise model.refused("one input: vectors of words cannot be given here; export with the vocabulary baked in")
    kind, shape = next(iter(inputs.values()), ("", []))
    if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3 or kind not in ("tensor(float)", "tensor(float16)"):
        raise model.refused(EXPECTED)
    if isinstance(shape[0], int) and shape[0] != 1:
        raise model.refused("one picture at a time, [1,3,height,width]; export with batch size 1")
    height, width = (length if isinstance(length, int) else side for length in shape[2:])
    return height, width


def padding(model: Model) -> int:
    """Level of grey around the picture, as the exporter trained with: those that name boxes pad with black.

    Raises InputError if the outputs are those of no family."""
    if {"boxes", "scores"} <= model.outputs.keys():
        return 0
    sides = sorted(len(shape) for _, shape in model.outputs.values())
    if sides not in ([0], [3], [3, 4]):  # 0: nothing is said of it; 4: what masks are made of
        raise model.refused(EXPECTED)
    return GREY


def read_words(path: Path) -> list[str]:
    """One a line, in the order of the classes. Raises InputError."""
    try:
        return _checked([line.strip() for line in path.read_text(encoding="utf-8").splitlines()], path)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text, one word a line ({error})") from None


def words_inside(model: Model) -> list[str]:
    """Metadata `names`: as Ultralytics writes them, a Python dict; or one a line. Raises InputError."""
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
    if not any(words) or len(words) > MOST:
        raise InputError(f"{path}: {len(words)} words; expected 1 to {MOST}, one a line, in the order of the classes")
    return list(words)
