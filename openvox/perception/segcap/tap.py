"""SegCap by Tokenize Anything (TAP), through its authors' torch package if it is installed: masks with sentences.

Weights are read as tensors only: a pickle, which can run anything, is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.parameters import Value, parameter
from openvox.core.types import Frame, Mask
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.onnx import check_size, digest_of_files, first_line
from openvox.perception.segcap.sam_picture import SIDE, fitted
from openvox.perception.segcap.words import captioned
from openvox.perception.stage import stage_digest

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

MODELS = ("tap_vit_b", "tap_vit_l", "tap_vit_h")
BATCH = 64
VERSION = 1


@dataclass(frozen=True, kw_only=True)
class TapOptions:
    """What the TOML file may say in [segcap]."""

    weights: str = parameter("", "", why="tensors only: .pt or .pth of torch.save, or .safetensors")
    model: str = parameter("tap_vit_l", "", choices=MODELS, why="the architecture that the weights are of")


class Tap:
    """One mask and one sentence a box. One frame at a time: the model keeps its words in a buffer."""

    Options = TapOptions
    name = "tap"

    def __init__(self, options: TapOptions, setting: Setting) -> None:
        weights = setting.file("segcap.weights", options.weights)
        check_size(weights)
        self.model_digest = digest_of_files(weights)
        self.device = _device()
        self._loads = partial(_loaded, options.model, weights)
        self._lock = Lock()
        self.parameters: Mapping[str, Value] = {"segcap.model": options.model, "segcap.weights": weights.name}
        self._digest = stage_digest(self.name, VERSION, {"model": options.model}, self.model_digest, self.device)

    @cached_property
    def _model(self) -> Any:
        return self._loads()

    def prepare(self) -> None:
        """Loads the weights and says what does not fit."""
        with self._lock:
            _ = self._model

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """In the order of the boxes; a box in which nothing is found has none."""
        if not boxes or not frame.color:
            return ()
        rgb = decode_color(frame)
        bitmaps: list[NDArray[np.bool_]] = []
        sentences: list[str] = []
        with self._lock, ExitStack() as stack:
            import torch

            stack.enter_context(torch.inference_mode())
            picture, inner, points = self._inputs(rgb, boxes)
            inputs = self._model.get_inputs({"img": picture})
            inputs.update(self._model.get_features(inputs))
            for start in range(0, len(points), BATCH):
                outputs = self._model.get_outputs({**inputs, "points": points[start : start + BATCH]})
                # Of the four masks the first is that of a box; the others answer points.
                logits = self._model.upscale_masks(outputs["mask_pred"][:, :1].float(), (SIDE, SIDE))[:, 0]
                bitmaps += [_back(found, inner, rgb.shape[:2]) for found in logits.cpu().numpy()]
                sentences += [str(text).strip() for text in self._model.generate_text(outputs["sem_tokens"][:, :1])]
        return captioned(rgb, bitmaps, boxes, sentences)

    def _inputs(
        self, rgb: NDArray[np.uint8], boxes: tuple[Box, ...]
    ) -> tuple[NDArray[np.float32], tuple[int, int], NDArray[np.float32]]:
        """The picture in BGR with its mean to the right and below, its size in there, and two points a box."""
        import cv2

        size = (rgb.shape[0], rgb.shape[1])
        inner = fitted(size, SIDE)
        picture = np.empty((1, SIDE, SIDE, 3), np.float32)
        picture[:] = self._model.pixel_mean_value
        picture[0, : inner[0], : inner[1]] = cv2.resize(rgb, inner[::-1], interpolation=cv2.INTER_LINEAR)[..., ::-1]
        points = np.empty((len(boxes), 2, 3), np.float32)
        corners = np.array([box.corners for box in boxes], np.float32).reshape(-1, 2, 2)
        points[..., :2] = corners * np.array([inner[1] / size[1], inner[0] / size[0]], np.float32)
        points[..., 2] = (2, 3)
        return picture, inner, points


def _back(logits: NDArray[np.float32], inner: tuple[int, int], size: tuple[int, ...]) -> NDArray[np.bool_]:
    """(h, w) of the picture's own size from the square."""
    import cv2

    cut = np.ascontiguousarray(logits[: inner[0], : inner[1]])
    return np.asarray(cv2.resize(cut, (size[1], size[0]), interpolation=cv2.INTER_LINEAR) > 0, np.bool_)


def _device() -> str:
    try:
        import torch
    except ImportError:
        return "CPU"
    return "CUDA" if torch.cuda.is_available() else "CPU"


def _loaded(name: str, weights: Path) -> Any:
    """The authors' model with its weights. Raises InputError."""
    try:
        import flash_attn  # noqa: F401  # without it the authors' package loads, and fails at the first picture
        import torch
        from tokenize_anything import model_registry
    except ImportError as error:
        raise InputError(
            f"[segcap] tap needs the packages tokenize-anything, torch and flash-attn ({error}); install them, or "
            "use stage sam"
        ) from None
    if name not in model_registry:
        raise InputError(f"tokenize-anything has no model {name}; it has {', '.join(model_registry)}")
    try:
        if weights.suffix == ".safetensors":
            from safetensors.torch import load_file

            tensors = load_file(str(weights))
        else:
            tensors = torch.load(str(weights), map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises pickle's, zip's and its own
        raise InputError(
            f"{weights}: cannot be read as tensors only ({first_line(error)}); "
            "docs/models.md says how to make such a file"
        ) from None
    model = model_registry[name]()
    try:
        model.load_state_dict(tensors)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise InputError(f"{weights}: not the weights of {name} ({first_line(error)})") from None
    model.text_decoder.reset_cache(max_batch_size=BATCH)
    return model
