"""Bitmaps as COCO compressed run lengths and back.

The text holds the lengths of runs of 0 and 1 in turn, 0 first, down the columns. From the fourth on, a length is
written as the difference to the one two before it. A number is written in groups of five bits, lowest first, each a
character from '0' (48) on; 32 is added where another group follows, and the highest bit written is the sign.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import MAX_IMAGE_SIDE, Bitmap

MAX_MASK_PIXELS = 1 << 26
"""A larger picture (8192 x 8192) is refused before anything is allocated for it."""
_MAX_GROUPS = 6


def decode_rle(counts: str, height: int, width: int) -> Bitmap:
    """The (height, width) bitmap of a text of counts. Raises InputError where they do not fill it exactly."""
    if not (0 < height <= MAX_IMAGE_SIDE and 0 < width <= MAX_IMAGE_SIDE and height * width <= MAX_MASK_PIXELS):
        raise InputError(
            f"mask is {width}x{height} pixels; expected sides of at least 1 and at most {MAX_MASK_PIXELS} pixels"
        )
    pixels = height * width
    if len(counts) > _MAX_GROUPS * (pixels + 2):
        raise InputError(f"mask counts are {len(counts)} letters long, more than {pixels} pixels can need")
    runs = _runs(counts)
    if len(runs) and int(runs.min()) < 0:
        raise InputError("mask counts hold a run of negative length; expected COCO compressed run lengths")
    if len(runs) > pixels + 2 or (len(runs) and int(runs.max()) > pixels):  # then their sum cannot wrap
        raise InputError(f"mask counts hold runs that {pixels} pixels have no room for")
    total = int(runs.sum())
    if total != height * width:
        raise InputError(
            f"mask counts cover {total} pixels; expected {height * width}, "
            f"as its size [{height}, {width}] (height, width) has"
        )
    values = np.zeros(len(runs), np.bool_)
    values[1::2] = True
    return np.repeat(values, runs).reshape(width, height).T


def _runs(counts: str) -> NDArray[np.int64]:
    """Lengths of the runs that the text spells, possibly negative."""
    try:
        groups = np.frombuffer(counts.encode("ascii"), np.uint8).astype(np.int64) - 48
    except UnicodeEncodeError:
        groups = np.full(1, -1, np.int64)
    if len(groups) and (int(groups.min()) < 0 or int(groups.max()) >= 64):
        raise InputError("mask counts hold a character that COCO compressed run lengths do not use")
    last = np.flatnonzero(groups < 32)
    if len(groups) and (not len(last) or last[-1] != len(groups) - 1):
        raise InputError("mask counts break off within a number; the text was cut")
    first = np.concatenate([[0], last[:-1] + 1]).astype(np.int64) if len(last) else last
    if len(last) and int((last - first).max()) >= _MAX_GROUPS:
        raise InputError("mask counts hold a run that no picture is large enough for")
    place = np.arange(len(groups)) - np.repeat(first, last - first + 1)
    numbers = np.add.reduceat((groups & 31) << (5 * place), first) if len(first) else first
    numbers -= np.where(groups[last] & 16, np.int64(1) << (5 * (last - first + 1)), 0)
    numbers[1::2] = np.cumsum(numbers[1::2])
    numbers[2::2] = np.cumsum(numbers[2::2])
    return numbers


def encode_rle(bitmap: Bitmap) -> str:
    """The text of counts of a bitmap, the same characters as pycocotools writes."""
    flat = bitmap.T.reshape(-1)
    edges = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    start = [0, 0] if len(flat) and flat[0] else [0]
    runs = np.diff(np.concatenate([start, edges, [len(flat)]])).tolist()
    return "".join(_text(run - runs[i - 2] if i > 2 else run) for i, run in enumerate(runs))


def _text(number: int) -> str:
    characters = []
    more = True
    while more:
        group, number = number & 31, number >> 5
        more = number != (-1 if group & 16 else 0)
        characters.append(chr(48 + group + 32 * more))
    return "".join(characters)
