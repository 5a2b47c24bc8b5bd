"""What Rerun is given in a form of ours: typed data, label images, the lens."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from openvox.core.types import Intrinsics
from openvox.view.labels import Label

PATH_COLOR = (255, 196, 0)


class Log(Protocol):
    """Logs archetypes to an entity, at the frame that was set."""

    def __call__(self, path: str, *what: Any, static: bool = False) -> None:
        """As rerun.log."""


def values(**columns: NDArray[Any] | Sequence[str]) -> rr.AnyValues:
    """Data of ours, typed here: what Rerun infers depends on what was logged before, and fails for empty lists."""
    return rr.AnyValues(
        **{
            name: pa.array(value) if isinstance(value, np.ndarray) else pa.array(value, pa.string())
            for name, value in columns.items()
        }
    )


def label_image(image: NDArray[np.int32], labels: Mapping[int, Label]) -> tuple[Any, Any]:
    """A label image with names and colours for its values; what has no label is left clear."""
    classes = np.zeros(max(int(image.max(initial=0)), *labels, 0) + 2, np.uint16)
    classes[[value + 1 for value in labels]] = range(1, len(labels) + 1)
    infos = [
        rr.AnnotationInfo(number, label.text, label.color) for number, label in enumerate(labels.values(), start=1)
    ]
    picture = rr.SegmentationImage(classes[image + 1].astype(np.min_scalar_type(len(labels))))
    return picture, rr.AnnotationContext([rr.AnnotationInfo(0, "", (0, 0, 0, 0)), *infos])


def pinhole(camera: Intrinsics) -> rr.Pinhole:
    """The colour camera's lens and frustum."""
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + 0.5, camera.cy + 0.5),  # Rerun counts from the pixel's corner
        resolution=(camera.width, camera.height),
        image_plane_distance=0.5,
        color=PATH_COLOR,
    )
