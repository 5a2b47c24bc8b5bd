"""What is borne by something narrower is one thing with it: a plant and its pot, a top and its legs.

The reverse of what stands on a broad top (see supports): what is top-heavy would not stand there by itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from openvox.perception.bodies import Body, Points

TOUCH = 0.05
"""m, beyond the noise: so near the end of a stem is to what it bears."""
END = 0.03
"""m below the top of a stem that are its end."""
TOUCHING = 0.3
"""Of the end of a stem that must be near what it bears: one side of it is seen."""
UNDER = 0.7
"""Of a stem that must lie under what it bears."""
THIN = 0.12
"""m, beyond the noise: the largest extent of a pole or leg."""


def stems(bodies: Sequence[Body], scraps: Sequence[bool]) -> Iterator[tuple[int, int]]:
    """Each stem with the largest segment that it bears, as positions in `bodies`.

    scraps: which are too small to be segments of their own; of these only what is thin and upright is a stem."""
    by_size = sorted(range(len(bodies)), key=lambda i: (-len(bodies[i].height), i))
    for stem, body in enumerate(bodies):
        reach = TOUCH + body.slack
        low, middle, high = body.levels
        if scraps[stem] and body.width > min(THIN + body.slack, high - low):
            continue
        for crown in by_size:
            its_low, its_middle, _ = bodies[crown].levels
            above = its_low - reach < high < its_middle and middle < its_low + reach
            if above and crown != stem and _bears(body, high, bodies[crown], reach):
                yield stem, crown
                break


def _bears(stem: Body, high: float, crown: Body, reach: float) -> bool:
    """Whether a stem lies under a crown and its end touches it."""
    if stem.share_within(crown, margin=reach) < UNDER:
        return False
    return _near(stem.points[:, stem.height > high - END], crown.points, reach) >= TOUCHING


def _near(points: Points, others: Points, reach: float) -> float:
    """Share of the points (3, n) whose cube of edge `reach`, or one beside it, holds one of the others (3, m)."""
    low = np.minimum(points.min(1), others.min(1))[:, None] - 2 * reach
    cells, known = (np.floor((p - low) / reach).astype(np.int64) for p in (points, others))
    size = np.maximum(cells.max(1), known.max(1)) + 2

    def key(cell: NDArray[np.int64]) -> NDArray[np.int64]:
        number: NDArray[np.int64] = (cell[0] * size[1] + cell[1]) * size[2] + cell[2]
        return number

    steps = [np.array([[i], [j], [k]]) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
    once = np.unique(key(known))
    around = np.concatenate([once + key(step)[0] for step in steps])
    return float(np.isin(key(cells), around).mean())
