"""Poses between stamps, and the tree of a robot's frames. Scalar float64 in fixed order: the same everywhere."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field, replace

from openvox.core.types import Pose
from openvox.formats.robot_log import Transform

Quaternion = tuple[float, float, float, float]
KEPT_NS = 5_000_000_000
"""How far behind the newest sample an older one is kept; pictures are not that late."""


def compose(a: Pose, b: Pose) -> Pose:
    """a after b: of world_from_body and body_from_camera, world_from_camera."""
    rows, (x, y, z) = a.rotation(), b.translation
    moved = [row[0] * x + row[1] * y + row[2] * z + t for row, t in zip(rows, a.translation, strict=True)]
    return Pose(_normal(_product(a.quaternion, b.quaternion)), (moved[0], moved[1], moved[2]))


def inverse(a: Pose) -> Pose:
    """The way back."""
    x, y, z, w = a.quaternion
    back = Pose((-x, -y, -z, w), (0.0, 0.0, 0.0))
    tx, ty, tz = (-sum(r * t for r, t in zip(row, a.translation, strict=True)) for row in back.rotation())
    return Pose(back.quaternion, (tx, ty, tz))


def between(a: Pose, b: Pose, share: float) -> Pose:
    """From a (share 0) to b (share 1): translation linear, rotation by the shorter arc."""
    t = tuple(p + share * (q - p) for p, q in zip(a.translation, b.translation, strict=True))
    return Pose(_slerp(a.quaternion, b.quaternion, share), (t[0], t[1], t[2]))


def placed(world_from_body: Pose, body_from_depth: Pose, origin: tuple[int, int, int]) -> Pose:
    """world_from_depth, with the origin subtracted."""
    pose = compose(world_from_body, body_from_depth)
    x, y, z = (value - metres for value, metres in zip(pose.translation, origin, strict=True))
    return replace(pose, translation=(x, y, z))


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def _slerp(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    dot = sum(p * q for p, q in zip(a, b, strict=True))
    sign = -1.0 if dot < 0 else 1.0
    angle = math.acos(min(1.0, abs(dot)))
    if angle < 1e-6:
        first, second = 1.0 - share, share
    else:
        first, second = math.sin((1.0 - share) * angle), math.sin(share * angle)
    x, y, z, w = (first * p + sign * second * q for p, q in zip(a, b, strict=True))
    return _normal((x, y, z, w))


def _normal(q: Quaternion) -> Quaternion:
    length = math.sqrt(sum(value * value for value in q))
    x, y, z, w = (value / length for value in q)
    return x, y, z, w


@dataclass
class Track:
    """One pose over time, by stamp. `window_ns`: how much of it is kept (None: all)."""

    window_ns: int | None = KEPT_NS
    repeated: int = 0
    """Samples whose stamp was there already; the first one counts."""
    disordered: int = 0
    """Samples that came after a later one; they were put where they belong."""
    _stamps: list[int] = field(default_factory=list)
    _poses: list[Pose] = field(default_factory=list)

    def add(self, stamp_ns: int, pose: Pose) -> None:
        """One more sample."""
        at = bisect_left(self._stamps, stamp_ns)
        if at < len(self._stamps):
            if self._stamps[at] == stamp_ns:
                self.repeated += 1
                return
            self.disordered += 1
        self._stamps.insert(at, stamp_ns)
        self._poses.insert(at, pose)
        if self.window_ns is not None and self._stamps[-1] - self._stamps[0] > 2 * self.window_ns:
            old = bisect_left(self._stamps, self._stamps[-1] - self.window_ns)
            del self._stamps[:old], self._poses[:old]

    def reaches(self, stamp_ns: int) -> bool:
        """True if there is a sample at that stamp or later."""
        return bool(self._stamps) and self._stamps[-1] >= stamp_ns

    def at(self, stamp_ns: int, max_gap_ns: int) -> Pose | str:
        """The pose at a stamp, between two samples that are not farther apart than that; or why there is none."""
        at = bisect_left(self._stamps, stamp_ns)
        if at < len(self._stamps) and self._stamps[at] == stamp_ns:
            return self._poses[at]
        if at == 0:
            return "begins later"
        if at == len(self._stamps):
            return "ends before"
        first, second = self._stamps[at - 1], self._stamps[at]
        if second - first > max_gap_ns:
            return f"has a gap of more than {max_gap_ns / 1e9:g} s"
        return between(self._poses[at - 1], self._poses[at], (stamp_ns - first) / (second - first))


@dataclass
class Tree:
    """The frames of a robot, each with its parent; those that never move, and those that do."""

    max_gap_ns: int
    tracks: dict[str, Track] = field(default_factory=dict)
    parent: dict[str, str] = field(default_factory=dict)
    static: dict[str, Pose] = field(default_factory=dict)
    changed: int = 0
    """How often a frame changed its parent."""

    def add(self, transform: Transform) -> None:
        """One more transform. A frame has one parent: the one named last."""
        child = transform.child
        if self.parent.get(child, transform.parent) != transform.parent:
            self.changed += 1
            self.tracks.pop(child, None)
        self.parent[child] = transform.parent
        if transform.static:
            self.static[child] = transform.pose
        else:
            self.static.pop(child, None)
            self.tracks.setdefault(child, Track()).add(transform.stamp_ns, transform.pose)

    def way_up(self, name: str) -> list[str]:
        """The frame and all above it."""
        way = [name]
        while (above := self.parent.get(way[-1])) is not None and above not in way:
            way.append(above)
        return way

    def edges(self, target: str, source: str) -> tuple[list[str], list[str]] | None:
        """Frames whose own transforms lead up from target, and up from source, to where the two meet."""
        up, down = self.way_up(target), self.way_up(source)
        meet = next((name for name in down if name in up), None)
        return None if meet is None else (up[: up.index(meet)], down[: down.index(meet)])

    def between(self, target: str, source: str) -> list[str]:
        """Frames whose own transforms lie between two frames and move."""
        return [name for part in self.edges(target, source) or () for name in part if name not in self.static]

    def ready(self, target: str, source: str, stamp_ns: int) -> bool:
        """True if everything between two frames is known up to that stamp."""
        if self.edges(target, source) is None:
            return False
        names = self.between(target, source)
        return all(name in self.tracks and self.tracks[name].reaches(stamp_ns) for name in names)

    def lookup(self, target: str, source: str, stamp_ns: int) -> Pose | str:
        """target_from_source at a stamp, or why there is none, in words."""
        edges = self.edges(target, source)
        if edges is None:
            return f"no transform of {source} in {target}"
        halves = []
        for part in edges:
            pose = Pose.identity()
            for name in part:
                step = self._step(name, stamp_ns)
                if isinstance(step, str):
                    return f"transform {self.parent[name]} <- {name} {step}"
                pose = compose(step, pose)
            halves.append(pose)
        return compose(inverse(halves[0]), halves[1]) if edges[0] else halves[1]

    def _step(self, name: str, stamp_ns: int) -> Pose | str:
        if name in self.static:
            return self.static[name]
        return self.tracks[name].at(stamp_ns, self.max_gap_ns) if name in self.tracks else "begins later"
