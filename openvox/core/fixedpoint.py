"""Numbers as integers: the arithmetic in which all decisions are made.

A value "in Q20" is the integer value * 2**20. Shares in parameters become parts of a million, so that a test such as
"at least 3 %" is a comparison of integers.
"""

from __future__ import annotations

from math import isqrt

import numpy as np
from numpy.typing import NDArray

Q20 = 1 << 20
MILLION = 1_000_000


def q20(value: float) -> int:
    """A probability in parts of 2**20, half to even."""
    return round(value * Q20)


def millionths(value: float) -> int:
    """A share or weight in parts of a million, half to even."""
    return round(value * MILLION)


def cosine(dot: int, square_a: int, square_b: int) -> int:
    """dot / (|a| |b|) in Q20, toward zero, from integers of any size; 0 if either vector is null."""
    if square_a == 0 or square_b == 0:
        return 0
    magnitude = isqrt((dot * dot << 40) // (square_a * square_b))
    return -magnitude if dot < 0 else magnitude


def quantised(embedding: NDArray[np.float32]) -> NDArray[np.int64]:
    """A unit vector as integers: rint(127 f), (D,) int64 within -127 .. 127."""
    return np.clip(np.rint(embedding.astype(np.float64) * 127.0), -127, 127).astype(np.int64)


def shortened(vector: NDArray[np.int64]) -> NDArray[np.int64]:
    """The vector with all components shifted down (toward minus infinity) until they fit 20 bits.

    Then sums of products over any usual dimension fit int64; a cosine changes by less than 2**-18."""
    largest = int(np.abs(vector).max(initial=0))
    return vector >> max(0, largest.bit_length() - 20)
