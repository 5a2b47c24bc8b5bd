"""Sentence encoders: texts to unit vectors. One is shipped: MiniLM (all-MiniLM-L6-v2, weights as int8)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.perception.onnx import Model

MODELS = Path(__file__).resolve().parents[1] / "models"
ENCODERS = {"minilm": MODELS / "minilm_l6_v2_int8"}
EXPECTED = "input_ids and attention_mask int64[b,n], perhaps token_type_ids, and states float[b,n,d] or vectors [b,d]"
MAX_TOKENS = 128
"""Longer texts are cut; captions have some ten tokens."""
POOLED: Mapping[str, Callable[[Any], Any]] = {
    "mean": lambda states: states.mean(0),
    "cls": lambda states: states[0],
    "max": lambda states: states.max(0),
}
"""One vector of the states (n, d) of a text's tokens."""
_REMEMBERED = 4096


@cache
def encoder(name: str) -> TextEncoder:
    """The encoder of that name, loaded once a process. Raises InputError if there is none."""
    if name not in ENCODERS:
        raise InputError(
            f"there is no encoder {name!r} here to put texts into numbers with; known: {', '.join(ENCODERS)}; "
            "one of your own is named by --models FILE.toml"
        )
    from tokenizers import BertWordPieceTokenizer

    words = ENCODERS[name] / "vocab.txt"
    model = Model(ENCODERS[name] / "model_int8.onnx", words)
    return TextEncoder(name, model, BertWordPieceTokenizer(str(words), lowercase=True))


class TextEncoder:
    """A sentence encoder: the last hidden states as one vector, brought to unit length.

    Each text goes through the model on its own, so that its vector depends on nothing else; the last few thousand
    are remembered. Safe to call from several threads. `model_digest`: SHA-256 over the files it is made of.
    """

    def __init__(self, name: str, model: Model, tokenizer: Any, pooling: str = "mean", prefix: str = "") -> None:
        tokenizer.enable_truncation(MAX_TOKENS)
        self.name, self.pooling, self.model_digest = name, pooling, model.digest
        self._model, self._tokenizer, self._prefix = model, tokenizer, prefix
        self._vector = lru_cache(_REMEMBERED)(self._encode)

    @property
    def device(self) -> str:
        """What the model runs on."""
        return self._model.device

    @property
    def dimensions(self) -> int:
        """Length of a vector. Raises InputError, as the model is tried for it."""
        return len(self._vector("a cup"))

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """(n, dimensions) float32, one row of unit length for each text. Raises InputError for a model that is none."""
        if not texts:
            return np.zeros((0, self.dimensions), np.float32)
        return np.stack([self._vector(text) for text in texts])

    def _encode(self, text: str) -> NDArray[np.float32]:
        names = self._model.inputs.keys()
        if not {"input_ids", "attention_mask"} <= names <= {"input_ids", "attention_mask", "token_type_ids"}:
            raise self._model.refused(EXPECTED)
        ids = np.array([self._tokenizer.encode(self._prefix + text).ids], np.int64)
        outputs = self._model.run_all(
            {"input_ids": ids, "attention_mask": np.ones_like(ids), "token_type_ids": np.zeros_like(ids)}
        )
        states = np.asarray(outputs.get("sentence_embedding", next(iter(outputs.values())))[0], np.float64)
        if states.ndim not in (1, 2) or (states.ndim == 2 and len(states) != ids.shape[1]):
            raise self._model.refused(EXPECTED)
        pooled = states if states.ndim == 1 else POOLED[self.pooling](states)
        length = float(np.linalg.norm(pooled))
        if not np.isfinite(length) or length == 0:
            raise InputError(f"{self._model.file}: the vector of {text!r} has length {length}; export the model again")
        vector: NDArray[np.float32] = (pooled / length).astype(np.float32)
        vector.flags.writeable = False
        return vector
