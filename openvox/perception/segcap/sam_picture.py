"""A picture as the image encoders of the SAM family take it, boxes in there, and masks brought back to the picture.

| encoder's input | who writes it | what goes in |
|---|---|---|
| `input_image` [1,3,s,s] | SAM, MobileSAM | longest side s, normalised, zeros to the right and below |
| `input_image` [h,w,3] | the same, `--use-preprocess` | longest side 1024, 0 to 255 |
| `batched_images` [b,3,h,w] | EfficientSAM | as it is, 0 to 1; points in its own pixels |
| `image` [1,3,s,s], `high_res_feats_...` come out | SAM 2 | stretched to the square, normalised |
| `image` [1,3,s,s] | EdgeSAM | as SAM |
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.formats.detections import Box
from openvox.perception.onnx import Model

EXPECTED_ENCODER = (
    "an image encoder with one input: input_image float[1,3,s,s] or float[h,w,3], batched_images float[b,3,h,w], or "
    "image float[1,3,s,s]"
)
MEAN = np.array([123.675, 116.28, 103.53], np.float32)
DEVIATION = np.array([58.395, 57.12, 57.375], np.float32)
"""Of red, green, blue, from 0 to 255."""
SIDE = 1024
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Picture:
    """`array`: what the encoder takes. `square`: (height, width) that low masks stand for. `inner`, `size`: (height,
    width) of the picture in it, and as it was."""

    array: Floats
    square: tuple[int, int]
    inner: tuple[int, int]
    size: tuple[int, int]

    @property
    def scale(self) -> tuple[float, float]:
        """(x, y) from the picture's pixels to those that prompts are in."""
        return self.inner[1] / self.size[1], self.inner[0] / self.size[0]

    def prompts(self, boxes: Sequence[Box]) -> Floats:
        """(n, 2, 2) upper left and lower right corners, x and y, as a decoder takes them."""
        corners = np.array([box.corners for box in boxes], np.float32).reshape(-1, 2, 2)
        return corners * np.array(self.scale, np.float32)

    def back(self, logits: Floats) -> Floats:
        """(h, w) logits in the picture's own size: some decoders answer in a small square, padding included."""
        import cv2

        if logits.shape == self.size:
            return logits
        large = np.asarray(cv2.resize(logits, self.square[::-1], interpolation=cv2.INTER_LINEAR), np.float32)
        inner = np.ascontiguousarray(large[: self.inner[0], : self.inner[1]])
        return np.asarray(cv2.resize(inner, self.size[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def picture_of(encoder: Model, rgb: NDArray[np.uint8]) -> Picture:
    """An (h, w, 3) picture for that encoder. Raises InputError for one of another signature."""
    name, (_, shape) = next(iter(encoder.inputs.items()), ("", ("", [])))
    if len(encoder.inputs) != 1:
        raise encoder.refused(EXPECTED_ENCODER)
    size = (rgb.shape[0], rgb.shape[1])
    if name == "batched_images" and len(shape) == 4:
        array = np.ascontiguousarray(rgb.transpose(2, 0, 1)[None]).astype(np.float32) * np.float32(1 / 255)
        return Picture(array, size, size, size)
    if name == "input_image" and len(shape) == 3:
        inner = fitted(size, SIDE)
        return Picture(_resized(rgb, inner), (SIDE, SIDE), inner, size)
    if name not in ("input_image", "image") or len(shape) != 4 or shape[1] != 3:
        raise encoder.refused(EXPECTED_ENCODER)
    side = shape[2] if isinstance(shape[2], int) else SIDE
    stretched = any(output.startswith("high_res_feats") for output in encoder.outputs)
    picture = in_corner(rgb, (side, side) if stretched else fitted(size, side), side, MEAN)
    array = np.ascontiguousarray(((picture.array - MEAN) / DEVIATION).transpose(2, 0, 1)[None])
    return dataclasses.replace(picture, array=array)


def in_corner(rgb: NDArray[np.uint8], inner: tuple[int, int], side: int, color: Any, how: int = -1) -> Picture:
    """An (h, w, 3) picture at the size `inner`, that colour to the right and below; `array` is (side, side, 3).

    how: OpenCV's interpolation, else areas where it shrinks and linear where it grows."""
    array = np.full((side, side, 3), color, np.float32)
    array[: inner[0], : inner[1]] = _resized(rgb, inner, how)
    return Picture(array, (side, side), inner, (rgb.shape[0], rgb.shape[1]))


def fitted(size: tuple[int, ...], side: int) -> tuple[int, int]:
    """(height, width) with the longest side as asked for, halves rounded up."""
    scale = side / max(size)
    return max(1, int(size[0] * scale + 0.5)), max(1, int(size[1] * scale + 0.5))


def _resized(rgb: NDArray[np.uint8], inner: tuple[int, int], how: int = -1) -> Floats:
    import cv2

    if how < 0:
        how = cv2.INTER_LINEAR if inner[0] >= rgb.shape[0] else cv2.INTER_AREA
    return np.asarray(cv2.resize(rgb, inner[::-1], interpolation=how), np.float32)
