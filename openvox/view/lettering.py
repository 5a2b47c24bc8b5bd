"""Text on pictures: light letters on a dark halo, legible on anything, and places where they do not overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Color = tuple[int, int, int]
WHITE: Color = (255, 255, 255)
HALO: Color = (24, 24, 28)
FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class Note:
    """A text that belongs to a point of the picture (x, y)."""

    text: str
    point: tuple[int, int]
    color: Color


def write(
    image: NDArray[np.uint8], text: str, at: tuple[int, int], *, scale: float = 0.5, color: Color = WHITE, halo: int = 3
) -> None:
    """Letters into an RGB picture; at: left end of the base line; halo: its width in pixels, 0 = none."""
    letters = np.zeros(image.shape[:2], np.uint8)
    cv2.putText(letters, text, at, FONT, scale, 255, 1, cv2.LINE_AA)
    if halo:
        dark = cv2.dilate(letters, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * halo + 1, 2 * halo + 1)))
        _blend(image, cv2.GaussianBlur(dark, (0, 0), halo / 3), HALO)
    _blend(image, letters, color)


def size_of(text: str, scale: float) -> tuple[int, int]:
    """Width and height of a line, pixels."""
    (width, height), base = cv2.getTextSize(text, FONT, scale, 1)
    return width, height + base


def annotate(image: NDArray[np.uint8], notes: Sequence[Note], *, scale: float = 0.45) -> None:
    """Write notes at their points, the first ones first; a later one moves aside, with a thin line, or is left out."""
    taken: list[tuple[int, int, int, int]] = []
    for note in notes:
        box = _free_box(image.shape, note.point, size_of(note.text, scale), taken)
        if box is None:
            continue
        taken.append(box)
        x, y = (box[0] + box[2]) // 2, (box[1] + box[3]) // 2
        if abs(note.point[1] - y) > box[3] - box[1]:
            end = (x, box[1] if note.point[1] < y else box[3])
            cv2.line(image, end, note.point, HALO, 3, cv2.LINE_AA)
            cv2.line(image, end, note.point, WHITE, 1, cv2.LINE_AA)
        write(image, note.text, (box[0] + 3, box[3] - 6), scale=scale)


def _free_box(
    shape: Sequence[int], point: tuple[int, int], size: tuple[int, int], taken: list[tuple[int, int, int, int]]
) -> tuple[int, int, int, int] | None:
    """Left, top, right, bottom of the nearest place above or below the point that is inside and free."""
    width, height = size[0] + 6, size[1] + 4
    left = min(max(point[0] - width // 2, 2), shape[1] - width - 2)
    for shift in (0, -1, 1, -2, 2, -3, 3):
        top = point[1] - height // 2 + shift * (height + 2)
        box = (left, top, left + width, top + height)
        inside = left >= 2 and top >= 2 and box[3] <= shape[0] - 2
        if inside and not any(_overlap(box, other) for other in taken):
            return box
    return None


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _blend(image: NDArray[np.uint8], cover: NDArray[Any], color: Color) -> None:
    share = cover[..., None].astype(np.float32) / 255
    image[:] = (image * (1 - share) + np.array(color, np.float32) * share + 0.5).astype(np.uint8)
