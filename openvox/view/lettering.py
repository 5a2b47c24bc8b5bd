"""Text on pictures: light letters on a dark halo, legible on anything, and places where they do not overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Color = tuple[int, int, int]
Box = tuple[int, int, int, int]
"""Left, top, right, bottom, pixels; the last two exclusive."""
WHITE: Color = (255, 255, 255)
HALO: Color = (24, 24, 28)
FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True, slots=True)
class Note:
    """A text that belongs to a point of the picture (x, y)."""

    text: str
    point: tuple[int, int]


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
    placed = place(image.shape, notes, scale)
    for note, (left, top, right, bottom) in placed:
        x, y = (left + right) // 2, (top + bottom) // 2
        if abs(note.point[1] - y) > bottom - top:
            end = (x, top if note.point[1] < y else bottom)
            cv2.line(image, end, note.point, HALO, 3, cv2.LINE_AA)
            cv2.line(image, end, note.point, WHITE, 1, cv2.LINE_AA)
    for note, (left, _, _, bottom) in placed:
        write(image, note.text, (left + 3, bottom - 6), scale=scale)


def place(shape: Sequence[int], notes: Sequence[Note], scale: float) -> list[tuple[Note, Box]]:
    """The notes that find a place inside a picture of that shape, each with its own."""
    placed: list[tuple[Note, Box]] = []
    for note in notes:
        box = _free_box(shape, note.point, size_of(note.text, scale), [box for _, box in placed])
        if box is not None:
            placed.append((note, box))
    return placed


def _free_box(shape: Sequence[int], point: tuple[int, int], size: tuple[int, int], taken: Sequence[Box]) -> Box | None:
    """The nearest place above or below the point that is inside and free."""
    width, height = size[0] + 6, size[1] + 4
    left = min(max(point[0] - width // 2, 2), shape[1] - width - 2)
    for shift in (0, -1, 1, -2, 2, -3, 3):
        top = point[1] - height // 2 + shift * (height + 2)
        box = (left, top, left + width, top + height)
        inside = left >= 2 and top >= 2 and box[3] <= shape[0] - 2
        if inside and not any(_overlap(box, other) for other in taken):
            return box
    return None


def _overlap(a: Box, b: Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _blend(image: NDArray[np.uint8], cover: NDArray[Any], color: Color) -> None:
    share = cover[..., None].astype(np.float32) / 255
    image[:] = (image * (1 - share) + np.array(color, np.float32) * share + 0.5).astype(np.uint8)
