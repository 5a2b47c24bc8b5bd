"""SegCap by Tokenize Anything (TAP), through its authors' torch package if it is installed: masks with sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
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
from openvox.perception.onnx import check_size, digest_of_files
from openvox.perception.segcap.sam_decoder import CORNERS
from openvox.perception.segcap.sam_picture import SIDE, fitted, in_corner
from openvox.perception.segcap.words import captioned
from openvox.perception.stage import stage_digest
from openvox.perception.tensors import torch_device, with_weights

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

BATCH = 64
VERSION = 1


@dataclass(frozen=True, kw_only=True)
class TapOptions:
    """What the TOML file may say in [segcap]."""

    weights: str = parameter("", "", why="tensors only: .pt or .pth of torch.save, or .safetensors")
    model: str = parameter("tap_vit_l", "", choices=("tap_vit_b", "tap_vit_l", "tap_vit_h"), why="of the weights")


class Tap:
    """One mask and one sentence a box. One frame at a time: the model keeps its words in a buffer."""

    Options = TapOptions
    name = "tap"

    def __init__(self, options: TapOptions, setting: Setting) -> None:
        weights = setting.file("segcap.weights", options.weights)
        check_size(weights)
        self.model_digest, self.device = digest_of_files(weights), torch_device()
        self._model, self._lock = cache(partial(_loaded, options.model, weights)), Lock()
        self.parameters: Mapping[str, Value] = {"segcap.model": options.model, "segcap.weights": weights.name}
        self._digest = stage_digest(self.name, VERSION, {"model": options.model}, self.model_digest, self.device)

    def prepare(self) -> None:
        """Loads the weights and says what does not fit."""
        with self._lock:
            self._model()

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """In the order of the boxes; a box in which nothing is found has none."""
        if not boxes or not frame.color:
            return ()
        import torch

        rgb = decode_color(frame)
        with self._lock, torch.inference_mode():
            bitmaps, sentences = zip(*_described(self._model(), rgb, boxes), strict=True)
        return captioned(rgb, bitmaps, boxes, sentences)


def _loaded(name: str, weights: Path) -> Any:
    """The authors' model with its weights. Raises InputError."""
    try:
        import flash_attn  # noqa: F401  # without it the authors' package loads, and fails at the first picture
        from tokenize_anything import model_registry
    except ImportError as error:
        raise InputError(
            f"[segcap] tap needs the packages tokenize-anything, torch and flash-attn ({error}); install them, or "
            "use stage sam"
        ) from None
    if name not in model_registry:
        raise InputError(f"tokenize-anything has no model {name}; it has {', '.join(model_registry)}")
    model = with_weights(model_registry[name](), weights, name)
    model.text_decoder.reset_cache(max_batch_size=BATCH)
    return model


def _described(model: Any, rgb: NDArray[np.uint8], boxes: Sequence[Box]) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """A mask and a sentence for each box. The model wants blue, green, red, and its mean to the right and below."""
    import cv2

    mean = np.asarray(model.pixel_mean_value)[::-1]
    picture = in_corner(rgb, fitted(rgb.shape[:2], SIDE), SIDE, mean, cv2.INTER_LINEAR)
    inputs = model.get_inputs({"img": np.ascontiguousarray(picture.array[None, ..., ::-1])})
    inputs.update(model.get_features(inputs))
    points = np.empty((len(boxes), 2, 3), np.float32)
    points[..., :2], points[..., 2] = picture.prompts(boxes), CORNERS
    for start in range(0, len(points), BATCH):
        outputs = model.get_outputs({**inputs, "points": points[start : start + BATCH]})
        # Of the four masks the first is that of a box; the others answer points.
        masks = model.upscale_masks(outputs["mask_pred"][:, :1].float(), (SIDE, SIDE))[:, 0].cpu().numpy()
        sentences = model.generate_text(outputs["sem_tokens"][:, :1])
        yield from ((picture.back(mask) > 0, str(text).strip()) for mask, text in zip(masks, sentences, strict=True))
