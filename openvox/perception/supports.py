"""What stands on what: one surface with it, and parted from it by height above the top; or a segment of its own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Pose
from openvox.perception.bodies import Body, body_of, pixels_of, within_outline
from openvox.perception.parameters import GeometryParameters, OfflineParameters
from openvox.perception.planes import Room
from openvox.perception.segments import Labels, components, renumbered
from openvox.perception.surface import Flags, Surface

FLOOR = 0
"""The number of the bearer of what stands on the floor by itself."""
NOISE = 0.5
"""Of the tolerance for steps in depth: many pixels decide together here, and a cup is low."""
SUNK, LIFT = 0.02, 0.05
"""m, beyond the noise: how far the lowest that is seen of a thing may be below and above the top that it stands on."""
NEAR_FLOOR = 0.1
"""m, beyond the noise, from the floor to the lowest that is seen of what stands there: its foot is taken for floor."""
FREE_HEIGHT = 0.15
"""m; what is lower on the floor may be a foot of something."""
AT_TOP = 0.04
"""m, beyond the noise: how far the top of what stands by itself may be from its highest part."""
COVER = 20
"""Pixels of other things above a top, from which on it may be a part of what is above it."""


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
        height, within = _above_top(body_of(pixels, surface, room, pose, geometry), offline)
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


def _above_top(body: Body, offline: OfflineParameters) -> tuple[NDArray[np.float64], Flags]:
    """How far a segment's pixels are above its top, beyond the noise, metres; and which lie within its outline."""
    top = body.top(offline.min_pixels)
    if top is None:
        return np.full(len(body.height), -1.0), np.zeros(len(body.height), np.bool_)
    level, at_top = top
    return body.height - level - NOISE * body.noise, within_outline(body.points, at_top, body.up)


def bearers(bodies: Sequence[Body], offline: OfflineParameters) -> dict[int, int]:
    """Of each segment that stands on another one, which: its lowest part is at the top of that, and nearly all of it
    within the outline of the top. The largest segment that fits is the bearer. Segments are numbered from 1."""
    large = [len(body.height) >= offline.min_pixels for body in bodies]
    low, high = (
        np.array([body.levels[at] if fit else np.nan for body, fit in zip(bodies, large, strict=True)]) for at in (0, 2)
    )
    found: dict[int, int] = {}
    for bearer in sorted(range(len(bodies)), key=lambda i: (-len(bodies[i].height), i)):
        body = bodies[bearer]
        top = body.top(offline.min_pixels)
        if top is None:
            continue
        level, at_top = top
        fits = (low > level - SUNK - body.slack) & (low < level + LIFT + body.slack)
        fits &= high > level + offline.support_height + NOISE * body.slack
        for thing in np.flatnonzero(fits).tolist():
            if thing == bearer or thing + 1 in found:
                continue
            if bodies[thing].share_within(body, at_top) >= offline.support_within:
                found[thing + 1] = bearer + 1
    return found


def free_standing(bodies: Sequence[Body], labels: Labels, room: Room, offline: OfflineParameters) -> dict[int, int]:
    """FLOOR as the bearer of each segment that stands there by itself, seen whole: it reaches the floor and ends in a
    top that nothing is above. A speaker does, beside a cabinet; legs, arms and backs of furniture do not."""
    if room.floor is None or not bodies:
        return {}
    cut = {*labels[0].tolist(), *labels[-1].tolist(), *labels[:, 0].tolist(), *labels[:, -1].tolist()}
    found = {}
    for number, body in enumerate(bodies, 1):
        low, _, high = body.levels
        bottom, height = low - room.floor.offset, high - room.floor.offset
        if number in cut or bottom > NEAR_FLOOR + body.slack or height < FREE_HEIGHT:
            continue
        top = body.top(offline.min_pixels)
        if top is None or abs(top[0] - high) > AT_TOP + body.slack:
            continue
        if not _covered(body, high + LIFT + body.slack, [other for other in bodies if other is not body]):
            found[number] = FLOOR
    return found


def _covered(body: Body, height: float, others: Sequence[Body]) -> bool:
    """Whether others are above that height within its outline."""
    above = [other.points[:, other.height > height] for other in others if other.levels[2] > height]
    points = np.concatenate([body.points, *above], 1)
    count = len(body.height)
    if points.shape[1] == count:
        return False
    inside = within_outline(points, np.arange(points.shape[1]) < count, body.up)[count:]
    return int(inside.sum()) > COVER
