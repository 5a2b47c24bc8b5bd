"""Captions for masks whose detector knew a word: colour and word, as in "a white cup"."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Mask
from openvox.formats.detections import Box
from openvox.perception.offline import colors_of
from openvox.perception.wording import Form


def captioned(
    rgb: NDArray[np.uint8], bitmaps: Sequence[NDArray[np.bool_]], boxes: Sequence[Box], texts: Sequence[str] = ()
) -> tuple[Mask, ...]:
    """One mask a box, those without pixels left out. texts: captions that are known already, one a box."""
    pairs = [(Mask.from_bitmap(bitmap), i) for i, bitmap in enumerate(bitmaps) if bitmap.any()]
    colors = colors_of(rgb, [mask for mask, _ in pairs])
    return tuple(
        dataclasses.replace(
            mask,
            score=boxes[i].score,
            label=boxes[i].label or "object",
            caption=texts[i] if texts else Form("", boxes[i].label or "object", "").caption(color),
            caption_score=boxes[i].score,
            named=bool(boxes[i].label or texts),
        )
        for (mask, i), color in zip(pairs, colors, strict=True)
    )
