"""What stands on what: one surface with it, and parted from it by height above the top; or a segment of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Pose
from openvox.perception.parameters import GeometryParameters, OfflineParameters
from openvox.perception.planes import Room, in_world, turned
from openvox.perception.segments import Labels, components, renumbered, tolerance
from openvox.perception.surface import Flags, Floats, Surface

HEIGHT_BIN = 0.01
NOISE = 0.5
"""Of the tolerance for steps in depth: many pixels decide together here, and a cup is low."""
FOOTPRINT = 0.02
"""m, edge of a cell of the top's outline seen from above."""
SUNK, LIFT = 0.02, 0.05
"""m, beyond the noise: how far the lowest that is seen of a thing may be below and above the top that it stands on."""
LOWEST = 4
"""Percent of a thing's pixels below which its lowest seen part lies, and above which its highest."""


def split_supports(
    labels: Labels, surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters, offline: OfflineParameters
) -> Labels:
    """The labels with what stands on a segment numbered on as pieces of their own.

    A segment's top is the height at which most of its surface faces up. What is clearly above it and within the top's
    outline stands on it, unless that is most of the segment."""
    out = labels.copy()
    number = int(labels.max())
    for pixels in pixels_of(labels):
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
    body = body_of(pixels, surface, room, pose, geometry)
    top = _top(body, offline.min_pixels)
    if top is None:
        return np.full(len(pixels), -1.0), np.zeros(len(pixels), np.bool_)
    level, at_top = top
    return body.height - level - NOISE * body.noise, within_outline(body.points, at_top, np.array(room.up))


def bearers(
    labels: Labels, surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters, offline: OfflineParameters
) -> dict[int, int]:
    """Of each segment that stands on another one, which: its lowest part is at the top of that, and nearly all of it
    within the outline of the top. The largest segment that fits is the bearer."""
    bodies = [body_of(pixels, surface, room, pose, geometry) for pixels in pixels_of(labels)]
    large = [len(body.height) >= offline.min_pixels for body in bodies]
    low, high = (
        np.array([np.percentile(body.height, at) if fit else np.nan for body, fit in zip(bodies, large, strict=True)])
        for at in (LOWEST, 100 - LOWEST)
    )
    found: dict[int, int] = {}
    for bearer in sorted(range(len(bodies)), key=lambda i: (-len(bodies[i].height), i)):
        body = bodies[bearer]
        top = _top(body, offline.min_pixels)
        if top is None:
            continue
        level, at_top = top
        noise = float(np.median(body.noise))
        fits = (low > level - SUNK - noise) & (low < level + LIFT + noise)
        fits &= high > level + offline.support_height + NOISE * noise
        for thing in np.flatnonzero(fits).tolist():
            if thing != bearer and thing + 1 not in found and _lies_in(bodies[thing], body, at_top, room, offline):
                found[thing + 1] = bearer + 1
    return found


def _lies_in(thing: Body, bearer: Body, at_top: Flags, room: Room, offline: OfflineParameters) -> bool:
    points = np.concatenate([bearer.points, thing.points], 1)
    outline = np.concatenate([at_top, np.zeros(len(thing.height), np.bool_)])
    within = within_outline(points, outline, np.array(room.up))[len(bearer.height) :]
    return int(within.sum()) >= offline.support_within * len(within)


def pixels_of(labels: Labels) -> list[NDArray[np.int64]]:
    """The pixels of each label from 1 on, ascending, in the flat picture."""
    flat = labels.reshape(-1)
    where = np.flatnonzero(flat)
    order = where[np.argsort(flat[where], kind="stable")]
    return np.split(order, np.searchsorted(flat[order], np.arange(2, int(labels.max()) + 1)))[: int(labels.max())]


@dataclass(frozen=True, eq=False)
class Body:
    """Pixels of one segment: points (3, n) in the world, height along `up`, whether they face up, depth and noise."""

    points: NDArray[np.float64]
    height: NDArray[np.float64]
    facing: Flags
    z: Floats
    noise: Floats


def body_of(pixels: NDArray[np.int64], surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters) -> Body:
    """What some pixels of the flat picture show. pixels: (n,)."""
    points = in_world(surface.points.reshape(3, -1)[:, pixels], pose)
    normals = turned(surface.normals.reshape(3, -1)[:, pixels], pose)
    z = surface.points[2].reshape(-1)[pixels]
    up = np.array(room.up)
    return Body(points, _along(points, up), _along(normals, up) > 0.9, z, tolerance(z, geometry))


def _top(body: Body, least: int) -> tuple[float, Flags] | None:
    """The height at which most of a segment faces up, and the pixels there; None if they are fewer than `least`."""
    height, facing = body.height, body.facing
    if int(facing.sum()) < least:
        return None
    low = float(height[facing].min())
    area = np.bincount(((height[facing] - low) / HEIGHT_BIN).astype(np.int64), body.z[facing].astype(np.float64) ** 2)
    level = low + (int(np.convolve(area, np.ones(3), "same").argmax()) + 0.5) * HEIGHT_BIN
    at_top: Flags = facing & (np.abs(height - level) < 2 * HEIGHT_BIN + body.noise)
    return (level, at_top) if int(at_top.sum()) >= least else None


def within_outline(points: NDArray[np.float64], outline: Flags, up: NDArray[np.float64], margin: float = 0.0) -> Flags:
    """Which points (3, n) lie, seen from above, in the convex outline of some of them, or `margin` metres near it."""
    import cv2

    east = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    east /= np.sqrt((east * east).sum())
    plan = np.stack([_along(points, east), _along(points, np.cross(up, east))], 1)
    low = plan.min(0)
    cells = np.minimum((plan - low) / FOOTPRINT, 4000).astype(np.int32)
    picture = np.zeros((int(cells[:, 1].max()) + 1, int(cells[:, 0].max()) + 1), np.uint8)
    hull = cv2.convexHull(cells[outline])
    cv2.fillConvexPoly(picture, hull, (1,))
    if margin:
        cv2.polylines(picture, [hull], True, (1,), 2 * round(margin / FOOTPRINT) + 1)
    result: Flags = picture[cells[:, 1], cells[:, 0]] > 0
    return result


def _along(vectors: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    result: NDArray[np.float64] = vectors[0] * axis[0] + vectors[1] * axis[1] + vectors[2] * axis[2]
    return result
