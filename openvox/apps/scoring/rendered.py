"""Rendered masks: the map seen from every true pose against the true masks, and the detections against them, too."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openvox.apps.scoring.seen import SeenMap
from openvox.apps.scoring.truth_images import TruthImage, count_images, truth_images
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap, Mask
from openvox.formats.perception import FrameMasks, read_masks

MIN_PIXELS = 100
"""Visible colour pixels that an object must have in a frame to count there."""


@dataclass(frozen=True, slots=True)
class RenderedMasks:
    """Means over frames and objects of the best IoU of any instance, or any detection, in that frame."""

    iou: float | None
    detected_iou: float | None
    """Over the frames that perception looked at."""


def score_rendered(
    result: InstanceMap, truth: Path, perception: Path | None, progress: Callable[[int, int], None] | None = None
) -> RenderedMasks | None:
    """None where the truth has no pictures. perception: the map's own, if it is there. Raises InputError."""
    total = count_images(truth)
    if not total:
        return None
    of_map, of_detections = _Mean(), _Mean()
    masks = _MasksByFrame(perception)
    seen_map = SeenMap(result)
    for done, image in enumerate(truth_images(truth), 1):
        seen = seen_map.labels(image)
        pixels = np.bincount(image.instances.ravel())
        visible = np.flatnonzero(pixels >= MIN_PIXELS)
        visible = visible[visible > 0]
        of_map.add(_best_rendered(image.instances, seen, pixels, visible))
        found = masks.of(image.frame)
        if found is not None:
            of_detections.add(_best_detected(image, found, pixels, visible))
        if progress is not None:
            progress(done, total)
    return RenderedMasks(of_map.value(), of_detections.value())


class _Mean:
    """A mean of numbers that come in groups."""

    def __init__(self) -> None:
        self._sum, self._n = 0.0, 0

    def add(self, values: NDArray[np.float64]) -> None:
        self._sum, self._n = self._sum + float(values.sum()), self._n + len(values)

    def value(self) -> float | None:
        return self._sum / self._n if self._n else None


class _MasksByFrame:
    """The masks of rising frame numbers, out of a file that is read once."""

    def __init__(self, path: Path | None):
        self._path = path
        self._frames: Iterator[FrameMasks] = iter(()) if path is None else read_masks(path)
        self._next = next(self._frames, None)

    def of(self, frame: int) -> FrameMasks | None:
        """None if perception did not look at the frame."""
        while self._next is not None and self._next.index < frame:
            self._next = next(self._frames, None)
        return self._next if self._next is not None and self._next.index == frame else None


def _best_rendered(
    truth: NDArray[np.uint16], seen: NDArray[np.int32], pixels: NDArray[np.int64], visible: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(n,) best IoU of any instance with each visible object. pixels: of every true id."""
    shown = np.maximum(seen, 0)
    ids, column = _columns(shown)
    table = np.bincount(truth.ravel().astype(np.int64) * len(ids) + column.ravel(), minlength=len(pixels) * len(ids))
    table = table.reshape(len(pixels), len(ids))
    both = table[visible]
    iou = both / (pixels[visible][:, None] + table.sum(0) - both)
    return np.asarray(np.where(ids > 0, iou, 0.0).max(1, initial=0.0))


def _columns(labels: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The ids of a picture, ascending, and the place of each pixel's id among them."""
    present = np.bincount(labels.ravel()) > 0
    return np.flatnonzero(present), (np.cumsum(present) - 1)[labels]


def _best_detected(
    image: TruthImage, found: FrameMasks, pixels: NDArray[np.int64], visible: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(n,) best IoU of any mask with each visible object."""
    if found.size != image.instances.shape:
        raise InputError(
            f"frame {found.index}: masks are {found.size[1]}x{found.size[0]}, the truth's picture "
            f"{image.instances.shape[1]}x{image.instances.shape[0]}; expected equal sizes"
        )
    best = np.zeros(len(visible))
    for mask in found.masks:
        both = _pixels_under(mask, image.instances, len(pixels))[visible]
        best = np.maximum(best, both / np.maximum(pixels[visible] + mask.area - both, 1))
    return best


def _pixels_under(mask: Mask, instances: NDArray[np.uint16], ids: int) -> NDArray[np.int64]:
    """(ids,) pixels of every true id under the mask."""
    x0, y0, x1, y1 = mask.box
    return np.bincount(instances[y0:y1, x0:x1][mask.crop()], minlength=ids)


def perception_of(map_path: Path, meta: Mapping[str, object]) -> tuple[Path | None, str]:
    """The perception file that a map was made from, if it is still there; else why not, in words."""
    from openvox.formats.perception import perception_info

    name, digests = meta.get("perception"), meta.get("digests")
    expected = digests.get("perception") if isinstance(digests, dict) else None
    if not isinstance(name, str) or not name or Path(name).is_absolute():
        return None, "the map names no perception file"
    path = map_path.parent / name
    if not path.is_file():
        return None, f"the map's perception file {path} is not there"
    try:
        found = perception_info(path).digest
    except InputError as error:
        return None, str(error)
    if found != expected:
        return None, f"{path} is not what the map was made from (another digest)"
    return path, ""
