"""Trim of a room: sills, frames, skirting boards. Narrow strips along a wall, of whatever shape: parts of the room."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from openvox.perception.bodies import Body, along
from openvox.perception.planes import Plane, Room
from openvox.perception.segments import Labels

RELIEF = 0.18
"""m from the wall's plane that trim keeps within; a shelf with things on it stands out farther."""
TOUCH = 0.1
"""m from the wall's plane at most, where it is nearest: trim is fastened to the wall, a lamp stands before it."""
NARROW = 0.2
"""m, to a cell; what is wider on a wall is a cupboard, a radiator, a picture."""
LONG = 3
"""Times its width that a strip is long at least: a clock is not."""
CELL = 0.02
"""m, edge of a cell of an outline seen from the room; finer ones would show gaps between pixels."""
OUTLIERS = 10
"""Percent of a body's pixels that may be nearer to the wall, and farther from it, than these limits."""


def trim(bodies: Sequence[Body], labels: Labels, room: Room, least: int) -> list[int]:
    """The labels of bodies of at least so many pixels that are trim of one of the room's walls.

    What the picture's edge cuts lengthways may be wider than it seems, as a cupboard of which the lowest part is seen:
    the cut is then longer than the root of the area."""
    rim = np.concatenate([labels[0], labels[-1], labels[1:-1, 0], labels[1:-1, -1]])
    cut = np.bincount(rim, minlength=len(bodies) + 1).tolist()
    seen = [n for n, body in enumerate(bodies, 1) if len(body.height) >= max(least, cut[n] ** 2)]
    return [n for n in seen if any(_is_strip(bodies[n - 1], wall) for wall in room.walls)]


def _is_strip(body: Body, wall: Plane) -> bool:
    """Whether a body keeps to a wall and is nowhere as wide as a third of its length."""
    low, high = np.percentile(along(body.points, wall.normal) - wall.offset, (OUTLIERS, 100 - OUTLIERS)).tolist()
    if low < -RELIEF or low > TOUCH or high > RELIEF:
        return False
    width, length = _width_and_length(np.stack([along(body.points, np.cross(wall.normal, body.up)), body.height], 1))
    return width < NARROW and length > LONG * width


def _width_and_length(points: NDArray[np.float64]) -> tuple[float, float]:
    """Metres: where it is widest, the distance between its sides, infinite where the points lie too far apart to tell,
    as those of what is seen along the wall; and the length of the rectangle around it.

    points (n, 2): seen from the room. A frame is as narrow as each of its four sides."""
    import cv2

    points = points - points.min(0)
    _, sides, _ = cv2.minAreaRect(points.astype(np.float32))
    margin = 4  # cells, so that nothing touches the picture's edge
    cells = np.minimum(points / CELL, 2000).astype(np.int64) + margin
    picture = np.zeros(cells.max(0) + margin + 1, np.uint8)
    picture[cells[:, 0], cells[:, 1]] = 1
    closed = np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)), np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    if 2 * int(np.asarray(stats)[1:, cv2.CC_STAT_AREA].max()) < int(closed.sum()):
        return math.inf, max(sides)
    return 2 * CELL * float(cv2.distanceTransform(closed, cv2.DIST_L2, 5).max()), max(sides)
