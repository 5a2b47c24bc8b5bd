"""A furnished room at random, with exact truth: RGB-D frames in the layout of the two rooms of docs/figures.md.

python tools/bench/rooms.py OUT SEED

Furniture is boxes, upright cylinders and balls without texture; the camera walks once around at eye height while it
turns almost twice. Depth has the noise of a structured-light sensor. For rooms that nobody tuned on, take another seed.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

HEIGHT, WIDTH, FOCAL, CX, CY = 480, 640, 525.0, 319.5, 239.5
CATEGORIES = {
    "wall": 1, "floor": 2, "cabinet": 3, "bed": 4, "chair": 5, "sofa": 6, "table": 7, "door": 8, "window": 9,
    "bookshelf": 10, "picture": 11, "desk": 14, "shelves": 15, "rug": 20, "ceiling": 22, "book": 23, "television": 25,
    "box": 29, "lamp": 35,
}  # fmt: skip
COLOURS = {
    "black": (40, 40, 40), "white": (235, 235, 230), "grey": (130, 130, 130), "brown": (60, 90, 140),
    "red": (50, 50, 190), "blue": (180, 90, 50), "green": (70, 140, 60), "yellow": (60, 200, 220),
    "orange": (40, 120, 230), "beige": (170, 200, 220),
}  # fmt: skip
"""Blue, green, red."""
BOX, CYLINDER, BALL = 0, 1, 2


class Part(NamedTuple):
    """A solid: middle, half extents (a cylinder's radius in the first), turn about the vertical; metres, radians."""

    kind: int
    x: float
    y: float
    z: float
    a: float
    b: float
    c: float
    turn: float = 0.0


class Solid(NamedTuple):
    """A part in the room, of a thing (0 = background)."""

    thing: int
    category: int
    colour: str
    part: Part


def box(x: float, y: float, z: float, width: float, depth: float, height: float, turn: float = 0.0) -> Part:
    return Part(BOX, x, y, z, width / 2, depth / 2, height / 2, turn)


def cylinder(x: float, y: float, z: float, radius: float, height: float) -> Part:
    return Part(CYLINDER, x, y, z, radius, radius, height / 2)


def ball(x: float, y: float, z: float, a: float, b: float | None = None, c: float | None = None) -> Part:
    return Part(BALL, x, y, z, a, b or a, c or a)


# ---- furniture; the back is at +y ------------------------------------------------------------------------------------


def table(width: float, depth: float, height: float) -> list[Part]:
    top, leg = 0.04, 0.05
    legs = [
        box(sx * (width / 2 - leg), sy * (depth / 2 - leg), (height - top) / 2, leg, leg, height - top)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    return [box(0, 0, height - top / 2, width, depth, top), *legs]


def chair() -> list[Part]:
    legs = [box(sx * 0.19, sy * 0.18, 0.215, 0.035, 0.035, 0.43) for sx in (-1, 1) for sy in (-1, 1)]
    return [box(0, 0, 0.45, 0.43, 0.42, 0.04), *legs, box(0, 0.2, 0.66, 0.43, 0.03, 0.38)]


def sofa(width: float, depth: float = 0.85) -> list[Part]:
    arms = [box(side * (width / 2 - 0.1), 0, 0.5, 0.2, depth, 0.2) for side in (-1, 1)]
    return [box(0, 0, 0.22, width, depth, 0.44), box(0, depth / 2 - 0.1, 0.62, width, 0.2, 0.4), *arms]


def shelf(width: float, depth: float, height: float, boards: int) -> list[Part]:
    sides = [box(side * (width / 2 - 0.015), 0, height / 2, 0.03, depth, height) for side in (-1, 1)]
    across = [box(0, 0, 0.02 + k * (height - 0.04) / boards, width, depth, 0.03) for k in range(boards + 1)]
    return [*sides, box(0, depth / 2 - 0.01, height / 2, width, 0.02, height), *across]


def bed(width: float, length: float) -> list[Part]:
    pillow = box(0, length / 2 - 0.3, 0.55, width * 0.8, 0.4, 0.12)
    return [box(0, 0, 0.25, width, length, 0.5), box(0, length / 2, 0.5, width, 0.06, 1.0), pillow]


def floor_lamp(height: float) -> list[Part]:
    return [
        cylinder(0, 0, 0.015, 0.14, 0.03),
        cylinder(0, 0, height / 2, 0.015, height),
        cylinder(0, 0, height, 0.2, 0.28),
    ]


def book(rng: np.random.Generator) -> list[Part]:
    return [box(0, 0, 0.02, 0.16 + 0.08 * rng.random(), 0.23, 0.02 + 0.03 * rng.random(), rng.random())]


SMALL: dict[str, Callable[[np.random.Generator], list[Part]]] = {
    "mug": lambda _: [cylinder(0, 0, 0.05, 0.042, 0.1), box(0.05, 0, 0.05, 0.03, 0.012, 0.06)],
    "cup": lambda _: [cylinder(0, 0, 0.035, 0.045, 0.07)],
    "bowl": lambda _: [cylinder(0, 0, 0.05, 0.13, 0.1)],
    "book": book,
    "laptop": lambda _: [box(0, 0, 0.01, 0.34, 0.24, 0.02), box(0, 0.12, 0.13, 0.34, 0.02, 0.22)],
    "vase": lambda _: [cylinder(0, 0, 0.12, 0.07, 0.24), cylinder(0, 0, 0.27, 0.04, 0.06)],
    "bottle": lambda _: [cylinder(0, 0, 0.11, 0.038, 0.22), cylinder(0, 0, 0.26, 0.015, 0.08)],
    "clock": lambda _: [box(0, 0, 0.06, 0.16, 0.05, 0.12)],
    "remote": lambda rng: [box(0, 0, 0.01, 0.05, 0.18, 0.02, rng.random() * 3)],
    "lamp": lambda _: [
        cylinder(0, 0, 0.01, 0.08, 0.02),
        cylinder(0, 0, 0.13, 0.015, 0.26),
        cylinder(0, 0, 0.33, 0.13, 0.18),
    ],
    "radio": lambda _: [box(0, 0, 0.1, 0.3, 0.1, 0.2)],
    "plant": lambda _: [cylinder(0, 0, 0.06, 0.06, 0.12), ball(0, 0, 0.22, 0.12, 0.12, 0.13)],
    "photo frame": lambda _: [box(0, 0, 0.1, 0.16, 0.03, 0.2)],
    "teddy bear": lambda _: [ball(0, 0, 0.1, 0.09, 0.08, 0.1), ball(0, 0, 0.24, 0.07)],
    "ball": lambda _: [ball(0, 0, 0.09, 0.09)],
    "box": lambda _: [box(0, 0, 0.09, 0.28, 0.2, 0.18)],
    "toy": lambda _: [box(0, 0, 0.05, 0.2, 0.09, 0.08), box(0, 0, 0.11, 0.1, 0.08, 0.05)],
}
ON_SHELVES = ("book", "vase", "box", "radio", "clock", "toy", "photo frame")
ON_THE_FLOOR = ("ball", "toy", "box", "teddy bear", "book")
ALONG_THE_WALLS = (
    "sofa", "wardrobe", "bookshelf", "cabinet", "desk", "bed", "shelves", "television", "drawer", "armchair",
    "armchair", "floor lamp", "bin", "plant", "nightstand", "backpack", "box", "guitar",
)  # fmt: skip
DRAWERS = {"cabinet": (1.2, 0.8, 0.45), "drawer": (0.8, 0.75, 0.45), "nightstand": (0.45, 0.5, 0.4)}
"""Width, height, depth."""
ALONE: dict[str, tuple[float, float, str | None, list[Part]]] = {
    "floor lamp": (0.45, 0.45, None, floor_lamp(1.5)),
    "bin": (0.3, 0.3, None, [cylinder(0, 0, 0.18, 0.14, 0.36)]),
    "plant": (
        0.5,
        0.5,
        "green",
        [cylinder(0, 0, 0.15, 0.15, 0.3), cylinder(0, 0, 0.45, 0.02, 0.3), ball(0, 0, 0.85, 0.3, 0.3, 0.35)],
    ),
    "backpack": (0.35, 0.3, None, [box(0, 0, 0.2, 0.32, 0.2, 0.4), box(0, -0.12, 0.12, 0.24, 0.08, 0.2)]),
    "guitar": (0.4, 0.3, None, [box(0, 0, 0.25, 0.36, 0.1, 0.46), box(0, 0, 0.75, 0.06, 0.04, 0.6)]),
}
"""Width and depth of the place, colour, parts."""

Spot = tuple[float, float, float]
"""x, y, turn."""


def placed(spot: Spot, parts: Sequence[Part], height: float = 0.0) -> list[Part]:
    x, y, turn = spot
    c, s = math.cos(turn), math.sin(turn)
    return [
        p._replace(x=x + c * p.x - s * p.y, y=y + s * p.x + c * p.y, z=p.z + height, turn=turn + p.turn) for p in parts
    ]


@dataclass
class Room:
    """What stands where. All chance comes from one generator, in the order of furnishing."""

    rng: np.random.Generator
    size: tuple[float, float, float] = (0.0, 0.0, 0.0)
    things: list[dict[str, Any]] = field(default_factory=list)
    solids: list[Solid] = field(default_factory=list)
    categories: dict[str, int] = field(default_factory=lambda: dict(CATEGORIES))
    taken: list[tuple[float, float, float]] = field(default_factory=list)

    def add(self, name: str, parts: Sequence[Part], colour: str | None = None) -> None:
        chosen = colour or list(COLOURS)[self.rng.integers(10)]
        word = name.replace(" ", "_")
        category = self.categories.setdefault(word, 101 + len(self.categories))
        number = len(self.things) + 1
        self.things.append(
            {
                "id": number,
                "name": name,
                "category": word,
                "caption": f"a {chosen} {name}",
                "colours": [chosen],
                "category_id": category,
            }
        )
        self.solids += [Solid(number, category, chosen, part) for part in parts]

    def is_free(self, x: float, y: float, radius: float) -> bool:
        if any((x - a) ** 2 + (y - b) ** 2 < (radius + other) ** 2 for a, b, other in self.taken):
            return False
        self.taken.append((x, y, radius))
        return True

    def wall_spot(self, width: float, depth: float) -> Spot | None:
        """A free place with its back to a wall."""
        along, across, _ = self.size
        for _ in range(60):
            wall = int(self.rng.integers(4))
            t = width / 2 + 0.1 + self.rng.random() * ((across if wall % 2 else along) - width - 0.2)
            x, y, turn = self.at_wall(wall, t, depth / 2 + 0.03)
            if self.is_free(x, y, max(width * 0.52, depth * 0.5)):
                return x, y, turn
        return None

    def at_wall(self, wall: int, t: float, away: float) -> Spot:
        along, across, _ = self.size
        spots = (
            (t, away, math.pi),
            (along - away, t, -math.pi / 2),
            (t, across - away, 0.0),
            (away, t, math.pi / 2),
        )
        return spots[wall]

    def small(self, x: float, y: float, height: float, name: str | None = None) -> None:
        name = name or list(SMALL)[self.rng.integers(len(SMALL))]
        turn = self.rng.random() * 6.28
        self.add(name, placed((x, y, turn), SMALL[name](self.rng), height))

    def scatter(self, spot: Spot, width: float, depth: float, height: float, count: int) -> None:
        """Small things on a top, none on another."""
        spots: list[tuple[float, float]] = []
        for _ in range(30 * count):
            if len(spots) >= count:
                break
            x, y = (self.rng.random() - 0.5) * (width - 0.2), (self.rng.random() - 0.5) * (depth - 0.16)
            if all((x - a) ** 2 + (y - b) ** 2 > 0.2**2 for a, b in spots):
                spots.append((x, y))
                at = moved(spot, x, y)
                self.small(at[0], at[1], height)


def moved(spot: Spot, right: float, back: float) -> Spot:
    x, y, turn = spot
    c, s = math.cos(turn), math.sin(turn)
    return x + c * right - s * back, y + s * right + c * back, turn


def furnish_wall(room: Room, what: str) -> None:
    rng = room.rng
    if what in ("bed", "sofa") and rng.random() < 0.35:
        return
    if what in ("sofa", "bed", "wardrobe"):
        width = {"sofa": 1.6, "bed": 1.0, "wardrobe": 0.9}[what] + {"wardrobe": 0.5}.get(what, 0.6) * rng.random()
        spot = room.wall_spot(width, {"sofa": 0.85, "bed": 2.0, "wardrobe": 0.55}[what])
        parts = {"sofa": sofa(width), "bed": bed(width, 2.0), "wardrobe": [box(0, 0, 1.0, width, 0.55, 2.0)]}[what]
        if spot:
            room.add(what, placed(spot, parts))
    elif what in ("bookshelf", "shelves"):
        width, height, boards = (0.9, 2.0, 5) if what == "bookshelf" else (0.8, 1.0, 3)
        if spot := room.wall_spot(width, 0.3):
            room.add(what, placed(spot, shelf(width, 0.3, height, boards)))
            for k in range(boards):
                if rng.random() < 0.5:
                    at = moved(spot, (rng.random() - 0.5) * (width - 0.35), -0.04)
                    name = ON_SHELVES[rng.integers(7)]
                    room.small(at[0], at[1], 0.04 + k * (height - 0.04) / boards, name)
    elif what in DRAWERS:
        width, height, depth = DRAWERS[what]
        if spot := room.wall_spot(width, depth):
            room.add(what, placed(spot, [box(0, 0, height / 2, width, depth, height)]))
            room.scatter(spot, width, depth, height, int(rng.integers(1, 4)))
    elif what == "television":
        if spot := room.wall_spot(1.4, 0.45):
            room.add("cabinet", placed(spot, [box(0, 0, 0.25, 1.4, 0.45, 0.5)]))
            screen = [box(0, 0.05, 0.55, 0.3, 0.2, 0.04), box(0, 0.08, 0.86, 0.95, 0.05, 0.56)]
            room.add("television", placed(spot, screen), "black")
            for side in (-1, 1):
                room.add("speaker", placed(moved(spot, side * 0.6, 0), [box(0, 0, 0.65, 0.18, 0.2, 0.3)]), "black")
    elif what == "desk":
        if spot := room.wall_spot(1.3, 0.65):
            room.add("desk", placed(spot, table(1.3, 0.65, 0.74)))
            room.scatter(spot, 1.3, 0.65, 0.74, 4)
            x, y, turn = moved(spot, 0, -0.55)
            room.add("chair", placed((x, y, turn + math.pi + (rng.random() - 0.5)), chair()))
    elif what == "armchair":
        if spot := room.wall_spot(0.9, 0.85):
            room.add("armchair", placed((spot[0], spot[1], spot[2] + (rng.random() - 0.5) * 0.5), sofa(0.9, 0.8)))
    elif what == "box":
        if spot := room.wall_spot(0.5, 0.5):
            room.add("box", placed(spot, [box(0, 0, 0.15, 0.45, 0.35, 0.3)]))
            if rng.random() < 0.6:
                room.small(spot[0], spot[1], 0.3)
    else:
        width, depth, colour, parts = ALONE[what]
        if spot := room.wall_spot(width, depth):
            room.add(what, placed(spot, parts), colour)


def furnish_middle(room: Room) -> Spot:
    """A table with things on it, chairs, pictures, and what lies on the floor; returns the table's place."""
    rng, (along, across, _) = room.rng, room.size
    x, y = along / 2 + (rng.random() - 0.5) * 0.8, across / 2 + (rng.random() - 0.5) * 0.5
    spot = (x, y, rng.random() * 3)
    dining = rng.random() < 0.6
    width, depth, height = (1.3, 0.8, 0.74) if dining else (1.1, 0.6, 0.45)
    room.taken.append((x, y, 0.9))
    room.add("dining table" if dining else "coffee table", placed(spot, table(width, depth, height)))
    room.scatter(spot, width, depth, height, 5)
    seats = ((-0.35, -0.55, math.pi), (0.35, -0.55, math.pi), (-0.35, 0.55, 0.0), (0.35, 0.55, 0.0))
    for right, back, turn in seats if dining else ():
        if rng.random() < 0.8:
            at = moved(spot, right, back)
            room.add("chair", placed((at[0], at[1], at[2] + turn + (rng.random() - 0.5) * 0.3), chair()), "brown")
    for _ in range(int(rng.integers(2, 5))):
        width, height = 0.4 + 0.5 * rng.random(), 0.3 + 0.4 * rng.random()
        wall = int(rng.integers(4))
        t = 0.6 + rng.random() * ((across if wall % 2 else along) - 1.2)
        room.add(
            "picture", placed(room.at_wall(wall, t, 0.01), [box(0, 0, 1.5 + 0.3 * rng.random(), width, 0.02, height)])
        )
    for _ in range(3):
        x, y = 0.6 + rng.random() * (along - 1.2), 0.6 + rng.random() * (across - 1.2)
        if room.is_free(x, y, 0.25):
            room.small(x, y, 0, ON_THE_FLOOR[rng.integers(5)])
    return spot


def background(size: tuple[float, float, float], rug: Spot) -> list[Solid]:
    x, y, z = size
    parts = (
        ("floor", "beige", Part(BOX, x / 2, y / 2, -0.05, x / 2 + 0.2, y / 2 + 0.2, 0.05)),
        ("ceiling", "white", Part(BOX, x / 2, y / 2, z + 0.05, x / 2 + 0.2, y / 2 + 0.2, 0.05)),
        ("wall", "beige", Part(BOX, x / 2, -0.05, z / 2, x / 2 + 0.2, 0.05, z / 2)),
        ("wall", "beige", Part(BOX, x / 2, y + 0.05, z / 2, x / 2 + 0.2, 0.05, z / 2)),
        ("wall", "white", Part(BOX, -0.05, y / 2, z / 2, 0.05, y / 2 + 0.2, z / 2)),
        ("wall", "white", Part(BOX, x + 0.05, y / 2, z / 2, 0.05, y / 2 + 0.2, z / 2)),
        ("rug", "red", Part(BOX, rug[0], rug[1], 0.004, 1.2, 0.8, 0.004, rug[2])),
        ("door", "brown", Part(BOX, x * 0.3, 0.0, 1.0, 0.42, 0.02, 1.0)),
        ("window", "blue", Part(BOX, x * 0.7, y, 1.5, 0.6, 0.015, 0.5)),
    )
    return [Solid(0, CATEGORIES[name], colour, part) for name, colour, part in parts]


def furnished(seed: int) -> Room:
    rng = np.random.default_rng(seed)
    room = Room(rng, (5 + rng.random() * 1.6, 4.2 + rng.random() * 1.2, 2.5))
    for what in ALONG_THE_WALLS:
        furnish_wall(room, what)
    room.solids += background(room.size, furnish_middle(room))
    return room


# ---- the camera ------------------------------------------------------------------------------------------------------


def camera_pose(share: float, room: Room, start: float) -> NDArray[np.float64]:
    """(4, 4) camera-to-world at a share of the walk."""
    x, y, _ = room.size
    angle = 2 * math.pi * share * 1.02 + start
    eye = np.array(
        [
            x / 2 + x * 0.30 * math.cos(angle),
            y / 2 + y * 0.28 * math.sin(angle),
            1.45 + 0.05 * math.sin(9 * share * 6.28),
        ]
    )
    yaw = start + 2 * math.pi * 1.85 * share + 0.25 * math.sin(5 * angle)
    pitch, roll = -0.38 + 0.14 * math.sin(4.3 * angle), 0.03 * math.sin(7 * angle)
    forward = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch)])
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = math.cos(roll), math.sin(roll)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = c * right + s * down, -s * right + c * down, forward, eye
    return pose


@njit(cache=True)  # type: ignore[untyped-decorator]
def cast(solids, rotation, eye, depth, nearest):  # type: ignore[no-untyped-def]
    """Depth along z and nearest solid of every pixel. solids: rows of kind, middle, half extents, cosine and sine."""
    for number in range(len(solids)):
        kind, cx, cy, cz, hx, hy, hz, co, si = solids[number]
        u0, u1, v0, v1 = 1e9, -1e9, 1e9, -1e9
        behind = False
        for a in (-1, 1):
            for b in (-1, 1):
                for c in (-1, 1):
                    x = cx + co * a * hx - si * b * hy - eye[0]
                    y = cy + si * a * hx + co * b * hy - eye[1]
                    z = cz + c * hz - eye[2]
                    right = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z
                    down = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z
                    ahead = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z
                    if ahead < 0.05:
                        behind = True
                    else:
                        u, v = FOCAL * right / ahead + CX, FOCAL * down / ahead + CY
                        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        if behind:
            u0, u1, v0, v1 = 0, WIDTH - 1, 0, HEIGHT - 1
        ox = co * (eye[0] - cx) + si * (eye[1] - cy)
        oy = -si * (eye[0] - cx) + co * (eye[1] - cy)
        oz = eye[2] - cz
        for v in range(max(0, int(v0)), min(HEIGHT - 1, int(v1) + 1) + 1):
            for u in range(max(0, int(u0)), min(WIDTH - 1, int(u1) + 1) + 1):
                a, b = (u - CX) / FOCAL, (v - CY) / FOCAL
                wx = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2]
                wy = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2]
                wz = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2]
                s = hit(kind, ox, oy, oz, co * wx + si * wy, -si * wx + co * wy, wz, hx, hy, hz)
                if s < depth[v, u]:
                    depth[v, u], nearest[v, u] = s, number


@njit(cache=True)  # type: ignore[untyped-decorator]
def hit(kind, ox, oy, oz, dx, dy, dz, hx, hy, hz):  # type: ignore[no-untyped-def]
    """Where a ray from o along d enters a solid around 0; 1e9 if nowhere ahead."""
    if kind == BOX:
        low, high = -1e9, 1e9
        for o, d, h in ((ox, dx, hx), (oy, dy, hy), (oz, dz, hz)):
            if abs(d) < 1e-9:
                if abs(o) > h:
                    low = 1e9
            else:
                first, second = (-h - o) / d, (h - o) / d
                low, high = max(low, min(first, second)), min(high, max(first, second))
        return low if low <= high and low > 0.01 else 1e9
    found = 1e9
    if kind == CYLINDER:
        a, b, c = dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - hx * hx
        root = b * b - a * c
        if root > 0 and a > 1e-12:
            q = (-b - math.sqrt(root)) / a
            if q > 0.01 and abs(oz + q * dz) <= hz:
                found = q
        if abs(dz) > 1e-9:
            for end in (-hz, hz):
                q = (end - oz) / dz
                if 0.01 < q < found and (ox + q * dx) ** 2 + (oy + q * dy) ** 2 <= hx * hx:
                    found = q
        return found
    a = (dx / hx) ** 2 + (dy / hy) ** 2 + (dz / hz) ** 2
    b = ox * dx / hx**2 + oy * dy / hy**2 + oz * dz / hz**2
    c = (ox / hx) ** 2 + (oy / hy) ** 2 + (oz / hz) ** 2 - 1
    root = b * b - a * c
    if root > 0:
        q = (-b - math.sqrt(root)) / a
        if q > 0.01:
            found = q
    return found


def measured(z: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.uint16]:
    """Depth in mm as a sensor gives it: frayed edges, noise growing with distance, disparity steps, shadows, holes."""
    shape = (HEIGHT, WIDTH)
    jitter = [
        cv2.resize(
            rng.standard_normal((HEIGHT // 16, WIDTH // 16)).astype(np.float32),
            shape[::-1],
            interpolation=cv2.INTER_CUBIC,
        )
        * 0.45
        for _ in range(2)
    ]
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    q = cv2.remap(z.astype(np.float32), u + jitter[0], v + jitter[1], cv2.INTER_NEAREST)
    grain = rng.standard_normal((HEIGHT // 2, WIDTH // 2)).astype(np.float32)
    q = q + (0.001 + 0.0016 * (q - 0.4) ** 2) * cv2.resize(grain, shape[::-1], interpolation=cv2.INTER_LINEAR) * 1.2
    disparity = FOCAL * 0.075 / np.maximum(q, 0.05)
    q = FOCAL * 0.075 / (np.round(disparity * 7) / 7)
    lost = (q < 0.4) | (q > 5)
    around = np.ones((3, 3))
    edge = cv2.dilate(z.astype(np.float32), around) - cv2.erode(z.astype(np.float32), around) > 0.06 * z
    lost |= edge & (rng.random(shape) < 0.5)
    lost |= (z - np.roll(z, -6, 1) > 0.25) & (rng.random(shape) < 0.8)
    slope = [np.abs(np.gradient(z, axis=axis)) / z * FOCAL for axis in (1, 0)]
    lost |= (1 / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2) < 0.3 * rng.random(shape)) & ~edge
    lost |= rng.random(shape) < 0.002
    out = np.rint(q * 1000)
    out[lost] = 0
    return np.asarray(out, np.uint16)


# ---- files -----------------------------------------------------------------------------------------------------------


class Points:
    """Noise-free surface points where depth was measured, the first of each 2 cm cell and thing."""

    def __init__(self) -> None:
        self._found: dict[tuple[int, ...], tuple[NDArray[np.float64], int]] = {}

    def add(
        self, z: NDArray[np.float64], depth: NDArray[np.uint16], things: Any, kinds: Any, pose: NDArray[np.float64]
    ) -> None:
        v, u = np.nonzero(depth > 0)
        ahead = z[v, u]
        camera = np.stack([(u - CX) / FOCAL * ahead, (v - CY) / FOCAL * ahead, ahead], 1)
        world = camera @ pose[:3, :3].T + pose[:3, 3]
        keys = np.concatenate([np.floor(world / 0.02).astype(np.int64), things[v, u][:, None].astype(np.int64)], 1)
        _, first = np.unique(keys, axis=0, return_index=True)
        for row in first.tolist():
            self._found.setdefault(tuple(keys[row]), (world[row], kinds[v[row], u[row]]))

    def save(self, path: Path) -> NDArray[np.int32]:
        """Returns each point's thing."""
        keys = sorted(self._found)
        instance = np.array([key[3] for key in keys], np.int32)
        np.savez_compressed(
            path,
            points=np.round(np.array([self._found[key][0] for key in keys]), 3).astype(np.float32),
            instance=instance,
            category=np.array([self._found[key][1] for key in keys], np.int32),
        )
        return instance


def describe(room: Room, seen: dict[int, list[int]], points: NDArray[np.int32], out: Path) -> None:
    for thing in room.things:
        parts = [solid.part for solid in room.solids if solid.thing == thing["id"]]
        low, high = np.full(3, 9.0), np.full(3, -9.0)
        for p in parts:
            c, s = abs(math.cos(p.turn)), abs(math.sin(p.turn))
            half = np.array([c * p.a + s * p.b, s * p.a + c * p.b, p.c])
            low, high = (
                np.minimum(low, np.array([p.x, p.y, p.z]) - half),
                np.maximum(high, np.array([p.x, p.y, p.z]) + half),
            )
        pixels, count = seen.get(thing["id"], []), int((points == thing["id"]).sum())
        thing.update(bounds=[low.round(3).tolist(), high.round(3).tolist()], model="", credit="", frames=len(pixels))
        thing.update(max_pixels=max(pixels, default=0), points=count, counted=len(pixels) >= 5 and count >= 15)
    counted = [thing for thing in room.things if thing["counted"]]
    words = sorted({thing["category"] for thing in counted})
    queries = [
        {"id": k, "type": "ontology", "text": word, "instances": [t["id"] for t in counted if t["category"] == word]}
        for k, word in enumerate(words)
    ]
    scene = {"scene": out.name, "size": room.size, "categories": room.categories, "objects": room.things}
    (out / "objects.json").write_text(json.dumps(scene))
    (out / "queries.json").write_text(json.dumps({"scene": out.name, "queries": queries}))


def make(out: Path, seed: int, frames: int = 180) -> None:
    room, rng = furnished(seed), np.random.default_rng(seed + 1000)
    for name in ("color", "depth", "pose", "intrinsic", "instance-filt", "label-filt"):
        (out / name).mkdir(parents=True, exist_ok=True)
    for name in ("color", "depth"):
        matrix = [[FOCAL, 0, CX, 0], [0, FOCAL, CY, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        np.savetxt(out / "intrinsic" / f"intrinsic_{name}.txt", matrix, fmt="%.6f")
    rows = np.array([[*s.part[:7], math.cos(s.part.turn), math.sin(s.part.turn)] for s in room.solids])
    thing_of, kind_of = (np.array([getattr(s, n) for s in room.solids]) for n in ("thing", "category"))
    colour_of = np.array([COLOURS[s.colour] for s in room.solids], float)
    points, seen = Points(), dict[int, list[int]]()
    start = rng.random() * 6.28
    for i in range(frames):
        pose = camera_pose(i / frames, room, start)
        z, nearest = np.full((HEIGHT, WIDTH), 1e9), np.zeros((HEIGHT, WIDTH), np.int64)
        cast(rows, pose[:3, :3].copy(), pose[:3, 3].copy(), z, nearest)
        nothing = z > 1e8
        things = np.where(nothing, 0, thing_of[nearest]).astype(np.uint16)
        kinds = np.where(nothing, 1, kind_of[nearest]).astype(np.uint16)
        z[nothing] = 9
        depth = measured(z, rng)
        depth[nothing] = 0
        steps = [np.minimum(1, np.abs(step) / z * FOCAL * 0.6) for step in np.gradient(z)]
        shade = np.clip(1 - 0.35 * steps[0] - 0.2 * steps[1], 0.3, 1)
        noise = rng.normal(0, 4, (HEIGHT, WIDTH, 3))
        picture = np.clip(colour_of[nearest] * shade[..., None] + noise, 0, 255).astype(np.uint8)
        cv2.imwrite(str(out / "color" / f"{i:06d}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 86])
        for name, image in (("depth", depth), ("instance-filt", things), ("label-filt", kinds)):
            cv2.imwrite(str(out / name / f"{i:06d}.png"), image)
        np.savetxt(out / "pose" / f"{i:06d}.txt", pose, fmt="%.9f")
        points.add(z, depth, things, kinds, pose)
        for thing, pixels in zip(*(each.tolist() for each in np.unique(things, return_counts=True)), strict=True):
            if thing and pixels >= 30:
                seen.setdefault(thing, []).append(pixels)
    (out / "stamps.txt").write_text("".join(f"{0.1 * (i + 1):.6f}\n" for i in range(frames)))
    describe(room, seen, points.save(out / "gt_points.npz"), out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("seed", type=int)
    chosen = parser.parse_args()
    make(chosen.out, chosen.seed)
