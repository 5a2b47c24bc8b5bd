"""The planes that bound a room (floor, ceiling, walls), found once a recording from a few frames spread over it.

A bounding plane is a large one with nearly nothing behind it: that one rule keeps table tops and cupboard fronts out
and needs no heights.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from openvox.core.digest import digest_of
from openvox.core.types import Frame, Pose
from openvox.perception.surface import Floats, Surface, dot

Vector = tuple[float, float, float]
Points = NDArray[np.float64]
"""(n, 3), metres in the world."""

CELL = 0.04
"""m; points are thinned to one in such a cube, so that their number is an area."""
BIN = 0.02
ANGLES = 72
FACING = 0.95
UPRIGHT = 0.3
"""Cosine of a wall's normal with `up`, at most."""
BEHIND = 0.10
BEHIND_SHARE = 0.02
SAMPLE = 6


@dataclass(frozen=True, slots=True)
class Plane:
    """Points x with normal . x = offset; the normal points into the room. World coordinates, metres."""

    normal: Vector
    offset: float


@dataclass(frozen=True, slots=True)
class Room:
    """`up`: unit vector against gravity in the world. `planes`: all that bound the room, floor and ceiling included."""

    up: Vector = (0.0, 0.0, 1.0)
    planes: tuple[Plane, ...] = field(default=())

    @property
    def floor(self) -> Plane | None:
        """The plane that faces up, if one was found."""
        facing = [plane for plane in self.planes if _dot(plane.normal, self.up) > FACING]
        return facing[0] if facing else None

    @property
    def walls(self) -> tuple[Plane, ...]:
        """The upright planes."""
        return tuple(plane for plane in self.planes if abs(_dot(plane.normal, self.up)) < UPRIGHT)

    def up_in(self, pose: Pose) -> Floats:
        """(3,) `up` in the axes of a camera with that camera-to-world pose."""
        rows = pose.rotation()
        return np.array([sum(self.up[i] * rows[i][j] for i in range(3)) for j in range(3)], np.float32)

    def digest(self) -> str:
        """SHA-256 of the numbers."""
        return digest_of([self.up, [[plane.normal, plane.offset] for plane in self.planes]])


def find_room(surfaces: Iterable[tuple[Frame, Surface]], min_area: float) -> Room:
    """The room that some frames show. min_area: m2 that must be seen of a plane."""
    points, normals, up = _samples(surfaces)
    if not len(points):
        return Room()
    up = _upright(normals, up)
    floor = _bounding_plane(points, normals, up, min_area)
    planes = [floor] if floor else []
    if floor:
        up = np.array(floor.normal)
    for direction in (-up, *_horizontal_directions(points, normals, up, min_area)):
        plane = _bounding_plane(points, normals, direction, min_area)
        if plane is not None and not any(_same(plane, other) for other in planes):
            planes.append(plane)
    return Room(_vector(up), tuple(planes))


def _samples(surfaces: Iterable[tuple[Frame, Surface]]) -> tuple[Points, Points, Points]:
    """Points and normals in the world, one a cell, and the mean of the cameras' upward axes."""
    points, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    up = np.zeros(3)
    for frame, surface in surfaces:
        keep = np.zeros_like(surface.valid)
        keep[::SAMPLE, ::SAMPLE] = True
        keep &= surface.valid & (dot(surface.normals, surface.normals) > 0.5)
        points.append(in_world(surface.points[:, keep], frame.world_from_depth).T)
        normals.append(turned(surface.normals[:, keep], frame.world_from_depth).T)
        up -= [row[1] for row in frame.world_from_depth.rotation()]
    all_points, all_normals = np.concatenate(points), np.concatenate(normals)
    cells = np.floor(all_points / CELL).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    first.sort()
    return all_points[first], all_normals[first], up


def _upright(normals: Points, cameras: Points) -> Points:
    """Up: where most surfaces face, of the cameras' mean upward axis and the world's axes near it.

    Each is moved to the mean of the normals near it, in narrowing cones."""
    start = _unit(cameras)
    axes = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    best, most = start, -1
    for up in [start, *(axis for axis in axes if float((axis * start).sum()) > 0.7)]:
        near = normals[_along(normals, up) > 0.9]
        for cone in (0.9, 0.9, 0.95, 0.95, 0.98, 0.98, 0.98):
            up = _unit(near.sum(0)) if len(near) else up
            near = normals[_along(normals, up) > cone]
        if len(near) > most:
            best, most = up, len(near)
    return best


def _horizontal_directions(points: Points, normals: Points, up: Points, min_area: float) -> list[Points]:
    """Peaks of the angles that upright surfaces face, strongest first."""
    east = _unit(np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0]))
    north = np.cross(up, east)
    upright = normals[np.abs(_along(normals, up)) < UPRIGHT]
    angle = np.arctan2(_along(upright, north), _along(upright, east))
    bins = np.floor(angle / (2 * math.pi) * ANGLES).astype(np.int64) % ANGLES
    count = np.bincount(bins, minlength=ANGLES)
    area = (np.roll(count, 1) + count + np.roll(count, -1)) * CELL**2
    peaks = [i for i in range(ANGLES) if area[i] >= min_area and area[i - 1] < area[i] >= area[(i + 1) % ANGLES]]
    peaks.sort(key=lambda i: (-area[i], i))
    return [
        math.cos(turn) * east + math.sin(turn) * north for turn in ((i + 0.5) / ANGLES * 2 * math.pi for i in peaks)
    ]


def _bounding_plane(points: Points, normals: Points, direction: Points, min_area: float) -> Plane | None:
    """The strongest large plane that faces `direction` and has nearly nothing behind it."""
    for _ in range(2):  # the second time along the normal of what was found
        along = _along(points, direction)
        facing = _along(normals, direction) > FACING
        place = _strongest(along, along[facing], min_area)
        if place is None:
            return None
        near = points[facing & (np.abs(along - place) < 3 * BIN)]
        direction = _fitted_normal(near, direction)
    offset = float(np.median(_along(near, direction)))
    return Plane(_vector(direction), offset)


def _strongest(along: Points, facing: Points, min_area: float) -> float | None:
    if not len(facing):
        return None
    low = math.floor(float(facing.min()) / BIN) - 1
    count = np.bincount(np.floor(facing / BIN).astype(np.int64) - low, minlength=3)
    area = np.convolve(count, [1, 1, 1], "same") * CELL**2
    ordered = np.sort(along)
    for i in sorted(range(len(area)), key=lambda i: (-area[i], i)):
        place = (i + low + 0.5) * BIN
        if area[i] < min_area:
            return None
        if np.searchsorted(ordered, place - BEHIND) < BEHIND_SHARE * len(along):
            return place
    return None


def _fitted_normal(points: Points, direction: Points) -> Points:
    """Normal of the plane through points by least squares, on the side of `direction`."""
    centred = points - points.mean(0)
    spread = np.array([[float((a * b).sum()) for b in centred.T] for a in centred.T])
    normal: Points = np.linalg.eigh(spread)[1][:, 0]
    return normal if float((normal * direction).sum()) > 0 else -normal


def _same(a: Plane, b: Plane) -> bool:
    return _dot(a.normal, b.normal) > 0.98 and abs(a.offset - b.offset) < 0.15


def in_world(points: Floats, world_from_depth: Pose) -> Points:
    """(3, n) points of the depth camera in the world, float64."""
    moved: Points = turned(points, world_from_depth) + np.array(world_from_depth.translation, np.float64)[:, None]
    return moved


def turned(vectors: Floats, pose: Pose) -> Points:
    """(3, n) vectors turned as the pose turns, float64, in fixed order."""
    x, y, z = vectors.astype(np.float64)
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in pose.rotation()])


def _along(vectors: Points, direction: Points | Sequence[float]) -> Points:
    result: Points = vectors[:, 0] * direction[0] + vectors[:, 1] * direction[1] + vectors[:, 2] * direction[2]
    return result


def _unit(vector: Points) -> Points:
    return vector / math.sqrt(math.fsum(float(x) ** 2 for x in vector))


def _vector(values: Points) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
