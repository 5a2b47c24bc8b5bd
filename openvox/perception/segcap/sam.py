"""SegCap from the ONNX files of a promptable segmenter, encoder and decoder: SAM and its kin.

The encoder sees the frame once; then every box is a prompt, all of a frame in as few calls as the decoder takes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.parameters import Value, parameter
from openvox.core.types import Frame, Mask
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.onnx import Model
from openvox.perception.segcap.sam_picture import EXPECTED_ENCODER, picture_of
from openvox.perception.segcap.words import captioned
from openvox.perception.stage import stage_digest

if TYPE_CHECKING:
    from openvox.perception.stages import Setting

EXPECTED = (
    "the decoder that belongs to the encoder: its outputs, point_coords and point_labels (or both with batched_), and "
    "perhaps mask_input, has_mask_input, orig_im_size; masks and iou_predictions come out"
)
BATCH = 32
"""Boxes a call: masks of full size take megabytes each."""
CORNERS = (2.0, 3.0)
"""Labels of the two points that are a box: upper left, lower right."""
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
        self._masks(np.zeros((48, 64, 3), np.uint8), [(8.0, 8.0, 24.0, 24.0)])

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """In the order of the boxes; a box in which nothing is found has none."""
        if not boxes or not frame.color:
            return ()
        rgb = decode_color(frame)
        return captioned(rgb, self._masks(rgb, [box.corners for box in boxes]), boxes)

    def _masks(
        self, rgb: NDArray[np.uint8], corners: Sequence[tuple[float, float, float, float]]
    ) -> list[NDArray[np.bool_]]:
        if len(self._encoder.inputs) != 1:
            raise self._encoder.refused(EXPECTED_ENCODER)
        picture = picture_of(self._encoder, rgb)
        known = self._encoder.run_all({next(iter(self._encoder.inputs)): picture.array})
        points = np.array(corners, np.float32).reshape(-1, 2, 2) * np.array(picture.scale, np.float32)
        step = BATCH if _takes_many(self._decoder) else 1
        found = []
        for start in range(0, len(points), step):
            outputs = self._decoder_run(known, points[start : start + step], rgb.shape[:2])
            found += [picture.back(logits) > 0 for logits in self._chosen(outputs, len(points[start : start + step]))]
        return found

    def _decoder_run(
        self, known: Mapping[str, NDArray[Any]], points: NDArray[np.float32], size: tuple[int, ...]
    ) -> dict[str, NDArray[Any]]:
        labels = np.tile(np.array(CORNERS, np.float32), (len(points), 1))
        shape = self._decoder.inputs.get("mask_input", ("", [1]))[1]
        values = {
            **known,
            "point_coords": points,
            "point_labels": labels,
            "batched_point_coords": points[None],
            "batched_point_labels": labels[None],
            "mask_input": np.zeros((shape[0] if isinstance(shape[0], int) else len(points), 1, 256, 256), np.float32),
            "has_mask_input": np.zeros(1, np.float32),
            "orig_im_size": np.array(size[:2]),
        }
        if len(known) == 1:
            values.setdefault("image_embeddings", next(iter(known.values())))
        if not self._decoder.inputs.keys() <= values.keys():
            raise self._decoder.refused(f"{EXPECTED}; the encoder has {self._encoder.signature()}")
        return self._decoder.run_all(values)

    def _chosen(self, outputs: Mapping[str, NDArray[Any]], boxes: int) -> NDArray[np.float32]:
        """(boxes, h, w) logits: of a box's masks the one that the model itself thinks best of."""
        masks = outputs.get("masks", outputs.get("output_masks"))
        ious = outputs.get("iou_predictions", outputs.get("scores"))
        if masks is None or ious is None or masks.size == 0:
            raise self._decoder.refused(EXPECTED)
        try:
            masks = masks.reshape(boxes, -1, *masks.shape[-2:])
            best = ious.reshape(boxes, masks.shape[1]).argmax(1)
        except ValueError:
            raise self._decoder.refused(f"{EXPECTED}, one set of masks a box") from None
        return np.asarray(masks[np.arange(boxes), best], np.float32)


def _takes_many(decoder: Model) -> bool:
    """True if the axis of boxes is left open: the usual export of SAM takes one at a time."""
    for name, axis in (("point_coords", 0), ("batched_point_coords", 1)):
        if name in decoder.inputs:
            return not isinstance(decoder.inputs[name][1][axis], int)
    raise decoder.refused(EXPECTED)
