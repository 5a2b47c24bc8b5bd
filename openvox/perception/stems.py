"""What is borne by something narrower is one thing with it: a plant and its pot, a top and its legs.

The reverse of what stands on a broad top (see supports): what is top-heavy would not stand there by itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Pose
from openvox.perception.parameters import GeometryParameters
from openvox.perception.planes import Room
from openvox.perception.segments import Labels, join, renumbered, root
from openvox.perception.supports import LOWEST, Body, body_of, pixels_of, within_outline
from openvox.perception.surface import Surface

Points = NDArray[np.float64]
TOUCH = 0.05
"""m, beyond the noise: so near the end of a stem is to what it bears."""
END = 0.03
"""m below the top of a stem that are its end."""
TOUCHING = 0.3
"""Of the end of a stem that must be near what it bears: one side of it is seen."""
UNDER = 0.7
"""Of a stem that must lie under what it bears."""


def joined_on_stems(labels: Labels, surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters) -> Labels:
    """The labels with every stem joined to the largest segment that it bears."""
    bodies = [body_of(pixels, surface, room, pose, geometry) for pixels in pixels_of(labels)]
    levels = [np.percentile(body.height, (LOWEST, 50, 100 - LOWEST)).tolist() for body in bodies]
    parent = list(range(len(bodies) + 1))
    by_size = sorted(range(len(bodies)), key=lambda i: (-len(bodies[i].height), i))
    for stem, body in enumerate(bodies):
        reach = TOUCH + float(np.median(body.noise))
        _, middle, high = levels[stem]
        for crown in by_size:
            low, its_middle, _ = levels[crown]
            above = low - reach < high < its_middle and middle < low + reach
            if above and crown != stem and _bears(body, high, bodies[crown], room, reach):
                join(parent, stem + 1, crown + 1)
                break
    table = np.array([root(parent, i) for i in range(len(parent))], np.int32)
    roots = table == np.arange(len(parent))
    roots[0] = False
    return renumbered(table[labels], roots)


def _bears(stem: Body, high: float, crown: Body, room: Room, reach: float) -> bool:
    """Whether a stem lies under a crown and its end touches it."""
    points = np.concatenate([crown.points, stem.points], 1)
    count = len(crown.height)
    under = within_outline(points, np.arange(points.shape[1]) < count, np.array(room.up), reach)[count:]
    if int(under.sum()) < UNDER * len(under):
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
