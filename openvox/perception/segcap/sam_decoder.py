"""The decoders of the SAM family: how many boxes they take a call, what they are given, which of their masks counts.

| prompts | who writes it |
|---|---|
| `point_coords` [1,n,2], `mask_input`, `has_mask_input`, `orig_im_size` | SAM, MobileSAM |
| the same with [k,n,2] | SAM 2 |
| the same without what follows | EdgeSAM |
| `batched_point_coords` [b,q,n,2], `orig_im_size` | EfficientSAM |
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.perception.onnx import Model

EXPECTED = (
    "the decoder that belongs to the encoder: its outputs, point_coords [k,n,2] and point_labels [k,n], or both with "
    "batched_ and an axis more, and perhaps mask_input, has_mask_input, orig_im_size; masks and iou_predictions come "
    "out"
)
BATCH = 32
"""Boxes a call: masks of full size take megabytes each."""
CORNERS = (2.0, 3.0)
"""Labels of the two points that are a box: upper left, lower right."""
PROMPTS = {"point_coords": 0, "batched_point_coords": 1}
"""The axis of boxes; that of a box's points is the next."""
Floats = NDArray[np.float32]


def boxes_a_call(decoder: Model) -> int:
    """Many if the axis of boxes is left open: the usual export of SAM takes one at a time. Raises InputError."""
    for name, axis in PROMPTS.items():
        if name in decoder.inputs:
            shape = decoder.inputs[name][1]
            if len(shape) != axis + 3:
                break
            if isinstance(shape[axis + 1], int) and shape[axis + 1] != len(CORNERS):
                raise decoder.refused(
                    f"two points a prompt, the corners of a box, or their number left open in {name}; export it so"
                )
            return 1 if isinstance(shape[axis], int) else BATCH
    raise decoder.refused(EXPECTED)


def decoded(encoder: Model, decoder: Model, known: Mapping[str, NDArray[Any]], points: Floats, size: Any) -> Floats:
    """(k, h, w) logits of k boxes: of each box's masks the one that the model itself thinks best of.

    known: what the encoder said. points: (k, 2, 2) corners. size: (height, width) of the picture. Raises InputError."""
    labels = np.tile(np.array(CORNERS, np.float32), (len(points), 1))
    many = decoder.inputs.get("mask_input", ("", [1]))[1][0]
    values = {
        **known,
        "point_coords": points,
        "point_labels": labels,
        "batched_point_coords": points[None],
        "batched_point_labels": labels[None],
        "mask_input": np.zeros((many if isinstance(many, int) else len(points), 1, 256, 256), np.float32),
        "has_mask_input": np.zeros(1, np.float32),
        "orig_im_size": np.array(size),
    }
    if len(known) == 1:
        values.setdefault("image_embeddings", next(iter(known.values())))
    if not decoder.inputs.keys() <= values.keys():
        raise decoder.refused(f"{EXPECTED}; the encoder has {encoder.signature()}")
    return _best(decoder, decoder.run_all(values), len(points))


def _best(decoder: Model, outputs: Mapping[str, NDArray[Any]], boxes: int) -> Floats:
    masks = outputs.get("masks", outputs.get("output_masks"))
    ious = outputs.get("iou_predictions", outputs.get("scores"))
    if masks is None or ious is None or masks.size == 0:
        raise decoder.refused(EXPECTED)
    try:
        masks = masks.reshape(boxes, -1, *masks.shape[-2:])
        best = ious.reshape(boxes, masks.shape[1]).argmax(1)
    except ValueError:
        raise decoder.refused(f"{EXPECTED}, one set of masks a box") from None
    return np.asarray(masks[np.arange(boxes), best], np.float32)
