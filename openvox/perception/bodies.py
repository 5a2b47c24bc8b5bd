"""A segment as a body in the world: its points, heights, outline from above, and the top on which things may stand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Pose
from openvox.perception.parameters import GeometryParameters
from openvox.perception.planes import Room, Vector, in_world, turned
from openvox.perception.segments import Labels, tolerance
from openvox.perception.surface import Flags, Floats, Surface

Points = NDArray[np.float64]
"""(3, n), metres in the world."""

HEIGHT_BIN = 0.01
FOOTPRINT = 0.02
"""m, edge of a cell of an outline seen from above."""
LOWEST = 4
"""Percent of a body's pixels below which its lowest seen part lies, and above which its highest; so to all sides."""
DIRECTIONS = 8
"""In which the extent of a body is measured, spread over half a turn."""


@dataclass(frozen=True, eq=False)
class Body:
    """Pixels of one segment: points (3, n) in the world, height along `up`, whether they face up, depth and noise."""

    points: Points
    height: NDArray[np.float64]
    facing: Flags
    z: Floats
    noise: Floats
    up: NDArray[np.float64]

    @cached_property
    def levels(self) -> tuple[float, float, float]:
        """Its lowest part, middle and highest part, metres along `up`."""
        low, middle, high = np.percentile(self.height, (LOWEST, 50, 100 - LOWEST)).tolist()
        return low, middle, high

    @cached_property
    def slack(self) -> float:
        """What noise may move a part of it, metres."""
        return float(np.median(self.noise))

    @cached_property
    def width(self) -> float:
        """Its largest horizontal extent, metres."""
        east, north = plan(self.points, self.up)
        turns = (math.pi * i / DIRECTIONS for i in range(DIRECTIONS))
        along = (math.cos(turn) * east + math.sin(turn) * north for turn in turns)
        return max(float(high - low) for low, high in (np.percentile(row, (LOWEST, 100 - LOWEST)) for row in along))

    def top(self, least: int) -> tuple[float, Flags] | None:
        """The height at which most of it faces up, and the pixels there; None if they are fewer than `least`."""
        if int(self.facing.sum()) < least:
            return None
        low = float(self.height[self.facing].min())
        cells = ((self.height[self.facing] - low) / HEIGHT_BIN).astype(np.int64)
        area = np.bincount(cells, self.z[self.facing].astype(np.float64) ** 2)
        level = low + (int(np.convolve(area, np.ones(3), "same").argmax()) + 0.5) * HEIGHT_BIN
        at_top: Flags = self.facing & (np.abs(self.height - level) < 2 * HEIGHT_BIN + self.noise)
        return (level, at_top) if int(at_top.sum()) >= least else None

    def share_within(self, other: Body, outline: Flags | None = None, margin: float = 0.0) -> float:
        """Share of it that lies, seen from above, in the convex outline of another body, or of some of its pixels."""
        own, count = len(self.height), len(other.height)
        chosen = np.zeros(count + own, np.bool_)
        chosen[:count] = True if outline is None else outline
        within = within_outline(np.concatenate([other.points, self.points], 1), chosen, self.up, margin)[count:]
        return int(within.sum()) / own


def bodies_of(labels: Labels, surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters) -> list[Body]:
    """The body of each label from 1 on."""
    return [body_of(pixels, surface, room, pose, geometry) for pixels in pixels_of(labels)]


def pixels_of(labels: Labels) -> list[NDArray[np.int64]]:
    """The pixels of each label from 1 on, ascending, in the flat picture."""
    flat = labels.reshape(-1)
    where = np.flatnonzero(flat)
    order = where[np.argsort(flat[where], kind="stable")]
    return np.split(order, np.searchsorted(flat[order], np.arange(2, int(labels.max()) + 1)))[: int(labels.max())]


def body_of(pixels: NDArray[np.int64], surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters) -> Body:
    """What some pixels of the flat picture show. pixels: (n,)."""
    points = in_world(surface.points.reshape(3, -1)[:, pixels], pose)
    normals = turned(surface.normals.reshape(3, -1)[:, pixels], pose)
    z = surface.points[2].reshape(-1)[pixels]
    up = np.array(room.up)
    return Body(points, along(points, up), along(normals, up) > 0.9, z, tolerance(z, geometry), up)


def within_outline(points: Points, outline: Flags, up: NDArray[np.float64], margin: float = 0.0) -> Flags:
    """Which points (3, n) lie, seen from above, in the convex outline of some of them, or `margin` metres near it."""
    import cv2

    seen = np.stack(plan(points, up), 1)
    low = seen.min(0)
    cells = np.minimum((seen - low) / FOOTPRINT, 4000).astype(np.int32)
    picture = np.zeros((int(cells[:, 1].max()) + 1, int(cells[:, 0].max()) + 1), np.uint8)
    hull = cv2.convexHull(cells[outline])
    cv2.fillConvexPoly(picture, hull, (1,))
    if margin:
        cv2.polylines(picture, [hull], True, (1,), 2 * round(margin / FOOTPRINT) + 1)
    result: Flags = picture[cells[:, 1], cells[:, 0]] > 0
    return result


def plan(points: Points, up: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two (n,) coordinates of the points seen from above, metres."""
    east = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    east /= np.sqrt((east * east).sum())
    return along(points, east), along(points, np.cross(up, east))


def along(vectors: Points, axis: NDArray[np.float64] | Vector) -> NDArray[np.float64]:
    """(n,) components of (3, n) vectors along an axis, in fixed order."""
    result: NDArray[np.float64] = vectors[0] * axis[0] + vectors[1] * axis[1] + vectors[2] * axis[2]
    return result
