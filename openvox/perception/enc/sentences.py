"""Enc from a folder as sentence-transformers writes them, with its model exported to ONNX."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.parameters import parameter
from openvox.perception.captions import CaptionEncoder
from openvox.perception.encoder import MAX_TOKENS
from openvox.perception.onnx import Model, check_size

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

EXPECTED = "input_ids and attention_mask int64[b,n], perhaps token_type_ids, and states float[b,n,d] or vectors [b,d]"
PLACES = ("model.onnx", "onnx/model.onnx")
REMEMBERED = 4096


@dataclass(frozen=True, kw_only=True)
class SentenceOptions:
    """What the TOML file may say in [enc]."""

    folder: str = parameter("", "", why="with tokenizer.json, model.onnx or onnx/model.onnx, and 1_Pooling/config.json")
    file: str = parameter("", "", why="the ONNX file in it, where it is another, as onnx/model_quantized.onnx")
    prefix: str = parameter("", "", why='put before every caption; E5 and kin want "query: "')


class Sentences:
    """Texts to unit vectors, each text on its own. `name` is the folder's: maps made with it say so.

    pooling: mean, cls or max of the states, if the model gives states. Raises InputError."""

    def __init__(self, folder: Path, file: str = "", prefix: str = "") -> None:
        self.name, self._prefix = folder.resolve().name, prefix
        self.pooling = _pooling(folder)
        tokenizer = folder / "tokenizer.json"
        check_size(tokenizer)
        self._model = Model.of_user(_model_file(folder, file), tokenizer)
        self.model_digest = self._model.digest
        self._tokenizer = _tokenizer(tokenizer)
        self._vector = lru_cache(REMEMBERED)(self._encode)

    @property
    def device(self) -> str:
        """What the model runs on."""
        return self._model.device

    @property
    def dimensions(self) -> int:
        """Length of a vector. Raises InputError, as the model is tried for it."""
        return len(self._vector("a cup"))

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """(n, dimensions) float32, one row of unit length for each text."""
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
        pooled = self._pooled(outputs, ids.shape[1])
        length = float(np.linalg.norm(pooled))
        if not np.isfinite(length) or length == 0:
            raise InputError(f"{self._model.file}: the vector of {text!r} has length {length}; export the model again")
        vector: NDArray[np.float32] = (pooled / length).astype(np.float32)
        vector.flags.writeable = False
        return vector

    def _pooled(self, outputs: dict[str, NDArray[Any]], tokens: int) -> NDArray[np.float64]:
        found = outputs.get("sentence_embedding", next(iter(outputs.values())))
        states: NDArray[np.float64] = np.asarray(found[0], np.float64)
        if states.ndim == 1:
            return states
        if states.ndim != 2 or len(states) != tokens:
            raise self._model.refused(EXPECTED)
        pooled: NDArray[np.float64] = {"mean": states.mean(0), "cls": states[0], "max": states.max(0)}[self.pooling]
        return pooled


class SentenceTransformers(CaptionEncoder):
    """The stage of [enc]: such a folder on captions."""

    Options = SentenceOptions

    def __init__(self, options: SentenceOptions, setting: Setting) -> None:
        encoder = Sentences(setting.folder("enc.folder", options.folder), options.file, options.prefix)
        super().__init__(encoder, {"enc.prefix": options.prefix, "enc.pooling": encoder.pooling})


def _model_file(folder: Path, file: str) -> Path:
    for name in [file] if file else PLACES:
        if (folder / name).is_file() and (folder / name).resolve().is_relative_to(folder.resolve()):
            return folder / name
    raise InputError(f"{folder}: there is no {file or ' and no '.join(PLACES)} in it; export the model to ONNX")


def _tokenizer(path: Path) -> Any:
    from tokenizers import Tokenizer

    try:
        tokenizer = Tokenizer.from_file(str(path))
    except Exception as error:  # tokenizers raises Exception itself
        raise InputError(f"{path}: cannot be read as a tokenizer ({error})") from None
    tokenizer.no_padding()
    tokenizer.enable_truncation(MAX_TOKENS)
    return tokenizer


def _pooling(folder: Path) -> str:
    """mean, cls or max, as the folder says; mean if it says nothing. Raises InputError for what is not known here."""
    modules = _json(folder / "modules.json", [])
    config = _json(folder / "1_Pooling" / "config.json", {})
    texts = {"mean": "mean", "cls": "cls", "max": "max", "mean_tokens": "mean", "cls_token": "cls", "max_tokens": "max"}
    try:
        further = [str(module["type"]).rsplit(".", 1)[-1] for module in modules]
        modes = [
            key.removeprefix("pooling_mode_") for key, on in config.items() if key.startswith("pooling_mode_") and on
        ]
        modes = modes or [str(config[key]) for key in ("pooling_mode",) if key in config]
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(f"{folder}: modules.json or 1_Pooling/config.json cannot be read ({error!r})") from None
    mode = texts.get(modes[0]) if modes else "mean"
    if mode is None or len(modes) > 1 or not set(further) <= {"Transformer", "Pooling", "Normalize"}:
        raise InputError(
            f"{folder} pools by {' and '.join(modes) or 'mean_tokens'}, its modules are "
            f"{', '.join(further) or 'not named'}; "
            "expected Transformer, one Pooling by mean_tokens, cls_token or max_tokens, and perhaps Normalize"
        )
    return mode


def _json(path: Path, absent: Any) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return absent
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error})") from None
