"""The map as masks: what the camera of each frame of a recording sees of each instance, as a detections file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.export_parameters import RenderedParameters
from openvox.core.types import Bitmap, InstanceMap
from openvox.formats.masks import encode_rle
from openvox.formats.recording import read_frames, recording_info
from openvox.view.render import render_map
from openvox.view.viewpoint import world_from_color

Progress = Callable[[int, int], None] | None


def rendered_masks(
    result: InstanceMap, recording: Path, parameters: RenderedParameters, progress: Progress = None
) -> Iterator[dict[str, Any]]:
    """One object a frame, as `perceive --detections` reads it: a mask for each instance that is seen, by id.

    A mask's score is the instance's confidence. What the map does not hold hides nothing. Raises InputError."""
    total = recording_info(recording).frames
    confidence = dict(zip(result.instance_id.tolist(), result.instance_confidence.tolist(), strict=True))
    captions = {one.id: one.caption for one in result.instances}
    with closing(read_frames(recording, truth=False)) as frames:
        for done, frame in enumerate(frames, 1):
            seen = render_map(
                result.voxel_index, result.voxel_instance, result.voxel_size, world_from_color(frame), frame.rig.color
            )
            detections = [
                _detection(seen == number, confidence[number], captions[number], number)
                for number in _seen(seen, parameters.min_pixels)
            ]
            yield {"frame": frame.index, "detections": detections}
            if progress is not None:
                progress(done, total)


def _seen(labels: NDArray[np.int32], least: int) -> list[int]:
    """Ids of the instances with so many pixels, ascending."""
    pixels = np.bincount(np.maximum(labels, 0).ravel())
    pixels[0] = 0
    return np.flatnonzero(pixels >= least).tolist()


def _detection(bitmap: Bitmap, score: float, caption: str, instance: int) -> dict[str, Any]:
    rows, columns = np.flatnonzero(bitmap.any(1)).tolist(), np.flatnonzero(bitmap.any(0)).tolist()
    return {
        "box": [columns[0], rows[0], columns[-1] + 1, rows[-1] + 1],
        "score": min(1.0, max(0.0, score)),
        "label": caption,
        "caption": caption,
        "named": bool(caption),
        "mask": {"size": list(bitmap.shape), "counts": encode_rle(bitmap)},
        "instance": instance,
    }
