"""A frame's masks painted into one image of labels, on the host for every engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Intrinsics, Mask
from openvox.mapper.engines import paint

Ints = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Painted:
    """Labels of colour pixels (0 = no mask, -1 = votes for nothing), and the masks behind each label."""

    image: Ints
    members: list[tuple[int, ...]]
    masks: Sequence[Mask | None]
    """None where too little is left of a mask."""


def combinations(masks: Sequence[Mask | None], camera: Intrinsics) -> Painted:
    """Every combination of masks that covers a pixel is a label."""
    image = np.zeros((camera.height, camera.width), np.int32)
    members: list[tuple[int, ...]] = [()]
    for m, mask in enumerate(masks):
        if mask is None:
            continue
        after = np.full(len(members), -1, np.int64)
        paint.paint_combination(image, read_only(mask.bits), *mask.box, after, len(members))
        made = [int(before) for before in np.flatnonzero(after >= 0)]
        made.sort(key=lambda before: int(after[before]))
        members += [(*members[before], m) for before in made]
    return Painted(image, members, masks)


def smallest_on_top(masks: Sequence[Mask | None], camera: Intrinsics, erosion: int) -> Painted:
    """The smallest mask has a pixel; pixels within `erosion` of another label vote for nothing."""
    image = np.zeros((camera.height, camera.width), np.int32)
    areas = {m: mask.area for m, mask in enumerate(masks) if mask is not None}
    order = sorted(areas, key=lambda m: (areas[m], -m))  # the smallest first, so that it has the lowest label
    for label in range(len(order), 0, -1):
        mask = masks[order[label - 1]]
        assert mask is not None
        paint.paint(image, read_only(mask.bits), *mask.box, label)
    members: list[tuple[int, ...]] = [(), *((m,) for m in order)]
    if not erosion:
        return Painted(image, members, masks)
    out = np.empty_like(image)
    paint.blur_borders(image, erosion, np.empty(image.shape, np.uint8), out)
    return Painted(out, members, masks)


def disjoint(masks: Sequence[Mask | None], camera: Intrinsics, window: int, least: int) -> Painted:
    """The smallest mask has a pixel, if the whole square of radius `window` around it is the mask's; of each mask at
    least so many pixels must be left. A pixel whose square is not whole, or leaves the picture, votes for nothing."""
    painted = smallest_on_top(masks, camera, window)
    image = painted.image
    if window:
        image[:window] = image[-window:] = image[:, :window] = image[:, -window:] = paint.UNKNOWN
    pixels = np.bincount(image[image >= 0], minlength=len(painted.members))
    few = np.flatnonzero(pixels < least)
    image[np.isin(image, few[few > 0])] = paint.UNKNOWN
    small = {painted.members[label][0] for label in few.tolist() if label}
    return Painted(image, painted.members, [None if m in small else mask for m, mask in enumerate(masks)])


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view that cannot be written: for arrays of either kind, a kernel is compiled once."""
    view = array.view()
    view.flags.writeable = False
    return view
