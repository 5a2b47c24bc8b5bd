"""Boxes become masks: a box takes the regions that lie in it, or what stands out in it by colour and depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.formats.detections import Box
from openvox.perception.parameters import OfflineParameters
from openvox.perception.parts import Parts
from openvox.perception.surface import Flags, Floats

BEARERS = frozenset({"dining table", "bed", "couch", "bench", "desk", "table"})
"""Things that others stand on: small regions in their boxes are those others."""
PARTS = {"keyboard": "laptop"}
"""Words for what may be a part of another thing."""
GRABCUT_SIDE = 120
FAR = 1e6


@dataclass(frozen=True, eq=False)
class Thing:
    """A mask in the making: the detection that found it, None = none, and the regions that nothing else may take."""

    bitmap: Flags
    box: Box | None
    regions: tuple[int, ...]


def claims(
    boxes: Sequence[Box], parts: Parts, rgb: NDArray[np.uint8], focal: float, parameters: OfflineParameters
) -> list[Thing]:
    """The detections that found a mask, small boxes first; each region goes to one of them.

    focal: pixels of the colour camera; how large a box is in metres."""
    labels, regions = parts.labels, len(parts.depths)
    area = np.bincount(labels.reshape(-1), minlength=regions)
    free = area > 0
    free[0] = False
    out = []
    for box in sorted(_whole(boxes), key=lambda box: (_size(box), box.corners)):
        x0, y0, x1, y1 = _pixels(box, labels.shape)
        if x1 - x0 < 4 or y1 - y0 < 4:
            continue
        inside = np.bincount(labels[y0:y1, x0:x1].reshape(-1), minlength=regions)
        taken = _taken(box, inside, area, free, parts, focal, parameters)
        bitmap = np.isin(labels, taken)
        if int(inside[taken].sum()) < parameters.claim_fill * (x1 - x0) * (y1 - y0):
            bitmap = cut_out((x0, y0, x1, y1), rgb, parts.z, parts.background)
            if int(bitmap.sum()) < parameters.cut_fill * (x1 - x0) * (y1 - y0):
                continue
            covered = np.bincount(labels[bitmap], minlength=regions)
            taken = np.flatnonzero(free & (2 * covered >= area)).tolist()
        free[taken] = False
        out.append(Thing(bitmap, box, tuple(taken)))
    return out


def _taken(
    box: Box,
    inside: NDArray[np.int64],
    area: NDArray[np.int64],
    free: Flags,
    parts: Parts,
    focal: float,
    parameters: OfflineParameters,
) -> list[int]:
    """The regions that a box takes: mostly in it, near its largest in depth, and not standing on one of the others."""
    fits = np.flatnonzero(free & (inside >= parameters.claim_inside * area))
    if not len(fits):
        return []
    main = int(fits[np.argmax(inside[fits])])
    x0, y0, x1, y1 = box.corners
    reach = 0.35 * max(x1 - x0, y1 - y0) * float(parts.depths[main]) / focal + 0.15
    near = fits[np.abs(parts.depths[fits] - parts.depths[main]) <= reach]
    if box.label in BEARERS:
        near = near[inside[near] >= 0.15 * inside[main]]
    taken = near.tolist()
    return [i for i in taken if parts.on.get(i) not in taken]


def cut_out(box: tuple[int, int, int, int], rgb: NDArray[np.uint8], z: Floats, background: Flags) -> Flags:
    """What stands out in a box by colour; the room's planes, and what is far behind, are certainly not it."""
    import cv2

    x0, y0, x1, y1 = box
    height, width = z.shape
    mx, my = max(2, round(0.15 * (x1 - x0))), max(2, round(0.15 * (y1 - y0)))
    a, b, c, d = max(0, y0 - my), min(height, y1 + my), max(0, x0 - mx), min(width, x1 + mx)
    scale = min(1.0, GRABCUT_SIDE / max(b - a, d - c))
    size = (max(8, round((d - c) * scale)), max(8, round((b - a) * scale)))
    picture = np.asarray(cv2.resize(rgb[a:b, c:d], size, interpolation=cv2.INTER_AREA), np.uint8)
    prior = np.full((b - a, d - c), cv2.GC_BGD, np.uint8)
    inner = prior[y0 - a : y1 - a, x0 - c : x1 - c]
    inner[:] = cv2.GC_PR_FGD
    there, planes = z[y0:y1, x0:x1], background[y0:y1, x0:x1]
    inner[planes | (there > _behind(there, planes))] = cv2.GC_BGD
    prior = np.asarray(cv2.resize(prior, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    out = np.zeros((height, width), np.bool_)
    if min(int((prior == kind).sum()) for kind in (cv2.GC_BGD, cv2.GC_PR_FGD)) < 20:
        return out
    cv2.setRNGSeed(0)
    found, _, _ = cv2.grabCut(
        picture, prior, (0, 0, 1, 1), np.zeros((1, 65)), np.zeros((1, 65)), 2, cv2.GC_INIT_WITH_MASK
    )
    cut = (found == cv2.GC_PR_FGD).astype(np.uint8)
    out[a:b, c:d] = cv2.resize(cut, (d - c, b - a), interpolation=cv2.INTER_NEAREST) > 0
    return out


def _behind(z: Floats, background: Flags) -> float:
    """Depth from which on a pixel in a box is behind the thing in its middle."""
    rows, columns = z.shape
    middle = (slice(rows // 4, rows - rows // 4), slice(columns // 4, columns - columns // 4))
    known = z[middle][(z[middle] > 0) & ~background[middle]]
    return FAR if len(known) < 20 else float(np.median(known)) * 1.1 + 0.25


def _whole(boxes: Sequence[Box]) -> list[Box]:
    """Without boxes around a part: mostly in a larger one of the same word that is as sure, or of the whole's word."""
    return [box for box in boxes if not any(_is_part(box, other) for other in boxes)]


def _is_part(box: Box, other: Box) -> bool:
    if _size(box) >= _size(other) or PARTS.get(box.label, box.label) != other.label:
        return False
    if box.label == other.label and box.score > other.score:
        return False
    a, b = box.corners, other.corners
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    return min(width, height) > 0 and width * height >= 0.8 * _size(box)


def _size(box: Box) -> float:
    x0, y0, x1, y1 = box.corners
    return (x1 - x0) * (y1 - y0)


def _pixels(box: Box, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    x0, y0, x1, y1 = (round(v) for v in box.corners)
    return max(0, x0), max(0, y0), min(shape[1], x1), min(shape[0], y1)
