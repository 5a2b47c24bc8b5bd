"""What stands on something and is one surface with it: parted by height above the strongest top of a segment."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Pose
from openvox.perception.parameters import GeometryParameters, OfflineParameters
from openvox.perception.planes import Room, in_world, turned
from openvox.perception.segments import Labels, components, renumbered, tolerance
from openvox.perception.surface import Flags, Surface

HEIGHT_BIN = 0.01
NOISE = 0.5
"""Of the tolerance for steps in depth: many pixels decide together here, and a cup is low."""
FOOTPRINT = 0.02
"""m, edge of a cell of the top's outline seen from above."""


def split_supports(
    labels: Labels, surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters, offline: OfflineParameters
) -> Labels:
    """The labels with what stands on a segment numbered on as pieces of their own.

    A segment's top is the height at which most of its surface faces up. What is clearly above it and within the top's
    outline stands on it, unless that is most of the segment."""
    out = labels.copy()
    count = int(labels.max())
    where = np.flatnonzero(labels.reshape(-1))
    order = where[np.argsort(labels.reshape(-1)[where], kind="stable")]
    bounds = np.searchsorted(labels.reshape(-1)[order], np.arange(1, count + 2))
    number = count
    for label in range(1, count + 1):
        pixels = order[bounds[label - 1] : bounds[label]]
        if len(pixels) < 2 * offline.min_pixels:
            continue
        height, within = _above_top(pixels, surface, room, pose, geometry, offline)
        raised = np.zeros(labels.size, np.uint8)
        raised[pixels[height > offline.support_rim]] = 1
        parts = components(raised.reshape(labels.shape), 8, offline.min_pixels)
        parts = renumbered(parts, _standing(parts.reshape(-1)[pixels], height, within, offline))
        if not parts.any() or 2 * int((parts > 0).sum()) > len(pixels):
            continue
        out = np.where(parts > 0, parts + number, out).astype(np.int32)
        number += int(parts.max())
    return out


def _standing(part: NDArray[np.int32], height: NDArray[np.float64], within: Flags, offline: OfflineParameters) -> Flags:
    """Which parts rise clearly and lie nearly whole within the outline of the top: arms and backs of a seat do not."""
    count = int(part.max(initial=0)) + 1
    size = np.bincount(part, minlength=count)
    rises = np.bincount(part[height > offline.support_height], minlength=count) > 0
    standing: Flags = rises & (np.bincount(part[within], minlength=count) >= offline.support_within * size)
    standing[0] = False
    return standing


def _above_top(
    pixels: NDArray[np.int64],
    surface: Surface,
    room: Room,
    pose: Pose,
    geometry: GeometryParameters,
    offline: OfflineParameters,
) -> tuple[NDArray[np.float64], Flags]:
    """How far a segment's pixels are above its top, beyond the noise, metres; and which lie within its outline."""
    points = in_world(surface.points.reshape(3, -1)[:, pixels], pose)
    normals = turned(surface.normals.reshape(3, -1)[:, pixels], pose)
    z = surface.points[2].reshape(-1)[pixels]
    up = np.array(room.up)
    height, facing = _along(points, up), _along(normals, up) > 0.9
    nothing = np.full(len(pixels), -1.0), np.zeros(len(pixels), np.bool_)
    if int(facing.sum()) < offline.min_pixels:
        return nothing
    low = float(height[facing].min())
    area = np.bincount(((height[facing] - low) / HEIGHT_BIN).astype(np.int64), z[facing].astype(np.float64) ** 2)
    top = low + (int(np.convolve(area, np.ones(3), "same").argmax()) + 0.5) * HEIGHT_BIN
    noise = tolerance(z, geometry)
    at_top = facing & (np.abs(height - top) < 2 * HEIGHT_BIN + noise)
    if int(at_top.sum()) < offline.min_pixels:
        return nothing
    return height - top - NOISE * noise, _within(points, at_top, up)


def _within(points: NDArray[np.float64], outline: Flags, up: NDArray[np.float64]) -> Flags:
    """Which points lie, seen from above, within the convex outline of some of them."""
    import cv2

    east = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    east /= np.sqrt((east * east).sum())
    plan = np.stack([_along(points, east), _along(points, np.cross(up, east))], 1)
    low = plan.min(0)
    cells = np.minimum((plan - low) / FOOTPRINT, 4000).astype(np.int32)
    picture = np.zeros((int(cells[:, 1].max()) + 1, int(cells[:, 0].max()) + 1), np.uint8)
    cv2.fillConvexPoly(picture, cv2.convexHull(cells[outline]), (1,))
    result: Flags = picture[cells[:, 1], cells[:, 0]] > 0
    return result


def _along(vectors: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = vectors[0] * axis[0] + vectors[1] * axis[1] + vectors[2] * axis[2]
    return result
