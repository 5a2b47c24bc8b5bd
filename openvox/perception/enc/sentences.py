"""Enc from a folder as sentence-transformers writes them, with its model exported to ONNX."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from openvox.core.errors import InputError
from openvox.core.parameters import parameter
from openvox.perception.captions import CaptionEncoder
from openvox.perception.encoder import POOLED, TextEncoder
from openvox.perception.onnx import Model, check_size

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

PLACES = ("model.onnx", "onnx/model.onnx")


@dataclass(frozen=True, kw_only=True)
class SentenceOptions:
    """What the TOML file may say in [enc]."""

    folder: str = parameter("", "", why="with tokenizer.json, model.onnx or onnx/model.onnx, and 1_Pooling/config.json")
    file: str = parameter("", "", why="the ONNX file in it, where it is another, as onnx/model_quantized.onnx")
    prefix: str = parameter("", "", why='put before every caption; E5 and kin want "query: "')


class SentenceTransformers(CaptionEncoder):
    """The stage of [enc]: such a folder on captions."""

    Options = SentenceOptions

    def __init__(self, options: SentenceOptions, setting: Setting) -> None:
        encoder = encoder_in(setting.folder("enc.folder", options.folder), options.file, options.prefix)
        super().__init__(encoder, {"enc.prefix": options.prefix, "enc.pooling": encoder.pooling})


def encoder_in(folder: Path, file: str = "", prefix: str = "") -> TextEncoder:
    """The encoder of a folder, called by its name. Raises InputError."""
    words = folder / "tokenizer.json"
    check_size(words)
    model = Model.of_user(_model_file(folder, file), words)
    return TextEncoder(folder.resolve().name, model, _tokenizer(words), _pooling(folder), prefix)


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
    return tokenizer


def _pooling(folder: Path) -> str:
    """mean, cls or max, as the folder says; mean if it says nothing. Raises InputError for what is not known here."""
    modules = _json(folder / "modules.json", [])
    config = _json(folder / "1_Pooling" / "config.json", {})
    try:
        further = [str(module["type"]).rsplit(".", 1)[-1] for module in modules]
        modes = [
            key.removeprefix("pooling_mode_") for key, on in config.items() if key.startswith("pooling_mode_") and on
        ]
        modes = modes or [str(config[key]) for key in ("pooling_mode",) if key in config]
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(f"{folder}: modules.json or 1_Pooling/config.json cannot be read ({error!r})") from None
    mode = modes[0].removesuffix("_tokens").removesuffix("_token") if modes else "mean"
    if mode not in POOLED or len(modes) > 1 or not set(further) <= {"Transformer", "Pooling", "Normalize"}:
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
