"""What detectors share: a picture put into a rectangle and boxes taken back out of it, and of like boxes the best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Letterbox:
    """How a picture was put into a rectangle: columns and rows times their scale, then moved by (left, top) pixels.

    The two scales differ where the picture does not come out at whole pixels. Coordinates are those of edges, 0 at
    the outer edge of the first pixel, so that a resized picture needs no half pixel of correction."""

    scale_x: float
    scale_y: float
    left: int
    top: int

    def undone(self, corners: Floats, width: int, height: int) -> Floats:
        """(n, 4) boxes of the rectangle in the pixels of the picture, cut at its rim."""
        x0, y0, x1, y1 = corners.T
        left, right = (((x - self.left) / self.scale_x).clip(0, width) for x in (x0, x1))
        top, bottom = (((y - self.top) / self.scale_y).clip(0, height) for y in (y0, y1))
        return np.stack([left, top, right, bottom], 1).astype(np.float32)


def letterboxed(rgb: NDArray[np.uint8], height: int, width: int, pad: int = 0) -> tuple[Floats, Letterbox]:
    """(1, 3, height, width) float32 RGB from 0 to 1, the picture amid grey of level `pad`, and where it is there."""
    import cv2

    old_height, old_width = rgb.shape[:2]
    scale = min(height / old_height, width / old_width)
    rows, columns = max(1, round(old_height * scale)), max(1, round(old_width * scale))
    top, left = (height - rows) // 2, (width - columns) // 2
    small = cv2.resize(rgb, (columns, rows), interpolation=cv2.INTER_LINEAR)
    out = np.full((height, width, 3), np.float32(pad) * np.float32(1 / 255), np.float32)
    out[top : top + rows, left : left + columns] = small * np.float32(1 / 255)
    place = Letterbox(columns / old_width, rows / old_height, left, top)
    return np.ascontiguousarray(out.transpose(2, 0, 1)[None]), place


def suppressed(
    corners: Floats, scores: Floats, kinds: NDArray[np.int64], same: float = 0.5, other: float = 0.8
) -> list[int]:
    """Rows to keep, best first, without boxes that overlap a better one: IoU above `same` if of its kind, else `other`.

    corners: (n, 4) x0, y0, x1, y1. Among equal scores the lower kind comes first, then the box further left."""
    order = np.lexsort((corners[:, 0], kinds, -scores))
    gone = np.zeros(len(corners), np.bool_)
    kept: list[int] = []
    for place, i in enumerate(order.tolist()):
        if gone[i]:
            continue
        kept.append(i)
        rest = order[place + 1 :]
        limits = np.where(kinds[rest] == kinds[i], same, other)
        gone[rest] |= box_ious(corners[i], corners[rest]) > limits
    return kept


def box_ious(box: Floats, others: Floats) -> NDArray[np.float64]:
    """(n,) common areas of a box and each of (n, 4) others over that of both; 0 where both are empty."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    common = sides.clip(0).prod(1).astype(np.float64)
    areas = (others[:, 2:] - others[:, :2]).prod(1).astype(np.float64)
    both = float((box[2:] - box[:2]).prod()) + areas - common
    return np.where(both > 0, common / np.where(both > 0, both, 1), 0.0)


def box_iou(a: Floats, b: Floats) -> float:
    """Common area of two boxes over that of both."""
    return float(box_ious(a, b[None])[0])
