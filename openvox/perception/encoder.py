"""Sentence encoders: texts to unit vectors. One is shipped: MiniLM (all-MiniLM-L6-v2, weights as int8)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.perception.onnx import Model

MODELS = Path(__file__).resolve().parents[1] / "models"
ENCODERS = {"minilm": MODELS / "minilm_l6_v2_int8"}
MAX_TOKENS = 128
"""Longer texts are cut; captions have some ten tokens."""
_REMEMBERED = 4096


@cache
def encoder(name: str) -> TextEncoder:
    """The encoder of that name, loaded once a process. Raises InputError if there is none."""
    if name not in ENCODERS:
        raise InputError(
            f"there is no encoder {name!r} here to put texts into numbers with; known: {', '.join(ENCODERS)}; "
            "one of your own is named by --models FILE.toml"
        )
    return TextEncoder(name, ENCODERS[name])


class TextEncoder:
    """A sentence encoder: mean of the last hidden states, brought to unit length.

    Each text goes through the model on its own, so that its vector depends on nothing else; the last few thousand
    are remembered. Safe to call from several threads. `model_digest`: SHA-256 over the files it is made of.
    """

    def __init__(self, name: str, folder: Path) -> None:
        from tokenizers import BertWordPieceTokenizer

        self.name = name
        self._model = Model(folder / "model_int8.onnx", folder / "vocab.txt")
        self.model_digest = self._model.digest
        self._tokenizer = BertWordPieceTokenizer(str(folder / "vocab.txt"), lowercase=True)
        self._tokenizer.enable_truncation(MAX_TOKENS)
        self._vector = lru_cache(_REMEMBERED)(self._encode)

    @property
    def dimensions(self) -> int:
        """Length of a vector, as the model says."""
        length: int = self._model.outputs["last_hidden_state"][1][-1]
        return length

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """(n, dimensions) float32, one row of unit length for each text."""
        if not texts:
            return np.zeros((0, self.dimensions), np.float32)
        return np.stack([self._vector(text) for text in texts])

    def _encode(self, text: str) -> NDArray[np.float32]:
        tokens = self._tokenizer.encode(text)
        ids = np.array([tokens.ids], np.int64)
        found = self._model.run(
            ["last_hidden_state"], input_ids=ids, attention_mask=np.ones_like(ids), token_type_ids=np.zeros_like(ids)
        )
        states = found[0][0].astype(np.float64)
        mean = states.sum(0) / len(states)
        vector: NDArray[np.float32] = (mean / np.linalg.norm(mean)).astype(np.float32)
        vector.flags.writeable = False
        return vector
