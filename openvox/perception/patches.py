"""Flat things that depth cannot part from what they lie or hang on: evenly coloured ground, other colours on it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from openvox.perception.parameters import OfflineParameters
from openvox.perception.segments import Labels, components
from openvox.perception.surface import Flags, Surface, dot

LIGHTNESS = 0.35
"""Weight of lightness in a difference of colours: shadows and light change it most."""
EVEN = 14.0
"""Lab units; within it a pixel has the ground's colour."""
EVEN_SHARE = 0.55
DISTINCT = 17.5
AROUND = 41
"""Working pixels, edge of the square in which the ground's colour is a mean."""
FILL = 0.62
"""Least share of its convex outline that a patch fills: things people lay down or hang up are compact."""


def with_patches(
    labels: Labels, grounds: Iterable[Flags], lab: NDArray[np.float32], parameters: OfflineParameters
) -> Labels:
    """The labels with patches on these grounds numbered on as pieces of their own. lab: (h, w, 3) CIE Lab."""
    out = labels.copy()
    number = int(labels.max())
    for ground in grounds:
        if int(ground.sum()) >= parameters.patch_ground:
            patches = _patches(ground, lab, parameters.min_pixels)
            out = np.where(patches > 0, patches + number, out).astype(np.int32)
            number += int(patches.max())
    return out


def tops(labels: Labels, surface: Surface, up: NDArray[np.float32]) -> Iterator[Flags]:
    """What faces up of each segment. up: (3,) in the depth camera's axes."""
    facing = dot(surface.normals, up) > 0.9
    for label in range(1, int(labels.max()) + 1):
        yield facing & (labels == label)


def _patches(ground: Flags, lab: NDArray[np.float32], min_pixels: int) -> Labels:
    """Compact parts of a ground that differ from the colour around them; none if it has no colour of its own."""
    import cv2

    nothing = np.zeros(ground.shape, np.int32)
    rows, columns = np.flatnonzero(ground.any(1)), np.flatnonzero(ground.any(0))
    part = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    here, color = ground[part], lab[part] * np.array([LIGHTNESS, 1, 1], np.float32)
    middle = np.median(color[here], axis=0).astype(np.float32)
    even = here & (_distance(color, middle) < EVEN)
    if int(even.sum()) < EVEN_SHARE * int(here.sum()):
        return nothing
    weight = even.astype(np.float32)
    size = (AROUND, AROUND)
    total = cv2.boxFilter(weight, -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    mean = cv2.boxFilter(color * weight[..., None], -1, size, normalize=False, borderType=cv2.BORDER_CONSTANT)
    away = _distance(color, (mean / np.maximum(total, 1)[..., None]).astype(np.float32))
    other = (here & (total > 0) & (away > EVEN)).astype(np.uint8)
    other = np.asarray(cv2.morphologyEx(other, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
    other = np.asarray(cv2.morphologyEx(other, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)), np.uint8)
    found, number = nothing.copy(), 0
    parts = components(other, 8, min_pixels)
    limit = 0.35 * int(here.sum())
    for label in range(1, int(parts.max()) + 1):
        patch = _filled_patch(parts == label)
        if min_pixels <= int(patch.sum()) <= limit and _is_compact(patch) and float(away[patch].mean()) >= DISTINCT:
            number += 1
            found[part][patch & here] = number
    return found


def _distance(color: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.float32]:
    difference = color - other
    result: NDArray[np.float32] = np.sqrt((difference * difference).sum(-1))
    return result


def _filled_patch(patch: Flags) -> Flags:
    import cv2

    outlines, _ = cv2.findContours(patch.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(patch.shape, np.uint8)
    cv2.drawContours(filled, outlines, -1, (1,), cv2.FILLED)
    return filled > 0


def _is_compact(patch: Flags) -> bool:
    import cv2

    points = cv2.findNonZero(patch.astype(np.uint8))
    if points is None:
        return False
    outline = np.zeros(patch.shape, np.uint8)
    cv2.fillConvexPoly(outline, cv2.convexHull(points), (1,))
    return int(patch.sum()) >= FILL * int(outline.sum())
