"""SegCap from the ONNX files of a promptable segmenter, encoder and decoder: SAM and its kin.

The encoder sees the frame once; then every box is a prompt, all of a frame in as few calls as the decoder takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from openvox.core.parameters import Value, parameter
from openvox.core.types import Frame, Mask
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.onnx import Model
from openvox.perception.segcap.sam_decoder import boxes_a_call, decoded
from openvox.perception.segcap.sam_picture import picture_of
from openvox.perception.segcap.words import captioned
from openvox.perception.stage import stage_digest

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

VERSION = 1


@dataclass(frozen=True, kw_only=True)
class SamOptions:
    """What the TOML file may say in [segcap]."""

    encoder: str = parameter("", "", why="the ONNX file of the image encoder")
    decoder: str = parameter("", "", why="the ONNX file of the prompt encoder and mask decoder")


class Sam:
    """One mask a box, with the box's word and its own colour as caption."""

    Options = SamOptions
    name = "sam"

    def __init__(self, options: SamOptions, setting: Setting) -> None:
        self._encoder = Model.of_user(setting.file("segcap.encoder", options.encoder))
        self._decoder = Model.of_user(setting.file("segcap.decoder", options.decoder))
        self.model_digest = f"{self._encoder.digest}{self._decoder.digest}"
        self.parameters: Mapping[str, Value] = {
            "segcap.encoder": self._encoder.file.name,
            "segcap.decoder": self._decoder.file.name,
        }
        self._digest = stage_digest(self.name, VERSION, {}, self.model_digest, self.device)

    @property
    def device(self) -> str:
        """What the encoder runs on."""
        return self._encoder.device

    def prepare(self) -> None:
        """Loads the models and says what does not fit."""
        self._masks(np.zeros((48, 64, 3), np.uint8), (Box((8.0, 8.0, 24.0, 24.0), 1.0, ""),))

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """In the order of the boxes; a box in which nothing is found has none."""
        if not boxes or not frame.color:
            return ()
        rgb = decode_color(frame)
        return captioned(rgb, self._masks(rgb, boxes), boxes)

    def _masks(self, rgb: NDArray[np.uint8], boxes: tuple[Box, ...]) -> list[NDArray[np.bool_]]:
        picture = picture_of(self._encoder, rgb)
        known = self._encoder.run_all({next(iter(self._encoder.inputs)): picture.array})
        points, step = picture.prompts(boxes), boxes_a_call(self._decoder)
        parts = (points[start : start + step] for start in range(0, len(points), step))
        return [
            picture.back(logits) > 0
            for part in parts
            for logits in decoded(self._encoder, self._decoder, known, part, rgb.shape[:2])
        ]
