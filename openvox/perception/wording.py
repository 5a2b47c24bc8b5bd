"""Honest words for nameless regions: size, colour, form and place, which depth and colour tell; no nouns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from openvox.core.phrases import COLORS
from openvox.core.types import Pose
from openvox.perception.bodies import along
from openvox.perception.planes import Room, in_world, turned
from openvox.perception.segments import Labels
from openvox.perception.surface import Flags, Surface, dot, pair

SUPPORT_GAP = 4
"""Working pixels below a region where that on which it stands is looked for."""


def color_words(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w) positions in COLORS of the pixels of an (h, w, 3) RGB picture."""
    red, green, blue = (rgb[..., i].astype(np.uint16) >> 3 for i in range(3))
    words: NDArray[np.uint8] = _color_table()[(red << 10) | (green << 5) | blue]
    return words


@cache
def _color_table() -> NDArray[np.uint8]:
    """Word of each colour of five bits a channel, by lightness, chroma and hue in CIE Lab."""
    import cv2

    levels = (np.arange(32, dtype=np.uint8) << 3) | 4
    rgb = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), -1).reshape(1, -1, 3)
    lab = cv2.cvtColor(rgb.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2Lab)[0]
    lightness, chroma = lab[:, 0], np.hypot(lab[:, 1], lab[:, 2])
    hue = np.degrees(np.arctan2(lab[:, 2], lab[:, 1])) % 360
    sector = np.digitize(hue, [50, 75, 110, 195, 300, 345])
    word = np.array([COLORS.index(name) for name in ("red", "orange", "yellow", "green", "blue", "purple", "red")])[
        sector
    ]
    warm, reddish = (sector == 1) | (sector == 2), (sector == 0) | (sector == 6)
    word[warm & (lightness < 55)] = COLORS.index("brown")
    word[warm & (lightness >= 55) & (chroma < 35)] = COLORS.index("beige")
    word[reddish & (lightness > 65) & (chroma < 45)] = COLORS.index("pink")
    plain = chroma < 12
    word[plain] = COLORS.index("grey")
    word[plain & (lightness > 78)] = COLORS.index("white")
    word[(plain & (lightness <= 30)) | (lightness < 12)] = COLORS.index("black")
    table: NDArray[np.uint8] = word.astype(np.uint8)
    return table


def color_of(counts: NDArray[np.int64]) -> str:
    """One or two words for (len(COLORS),) counts of pixels; two where the second has 30 % and the first below 60 %."""
    total = int(counts.sum())
    if not total:
        return ""
    first, second = np.argsort(-counts, kind="stable")[:2].tolist()
    if counts[first] < 0.6 * total and counts[second] >= 0.3 * total:
        return f"{COLORS[first]} and {COLORS[second]}"
    return COLORS[first]


@dataclass(frozen=True, slots=True)
class Form:
    """What a region's depth tells: a word for its size, what it is, and where."""

    size: str
    thing: str
    place: str

    def caption(self, color: str) -> str:
        """As in "a small white object on a table-high surface"."""
        words = " ".join(word for word in (self.size, color, self.thing, self.place) if word)
        return f"{'an' if words[0] in 'aeiou' else 'a'} {words}"


def forms(labels: Labels, surface: Surface, room: Room, world_from_depth: Pose) -> dict[int, Form]:
    """The form of every label above 0. labels: (h, w), at the surface's resolution."""
    supported = _supported(labels, surface, room, world_from_depth)
    flat = labels.reshape(-1)
    order = np.argsort(flat, kind="stable")
    bounds = np.searchsorted(flat[order], np.arange(len(supported) + 1))
    out = {}
    for label in range(1, len(supported)):
        where = order[bounds[label] : bounds[label + 1]]
        if len(where):
            points = in_world(surface.points.reshape(3, -1)[:, where], world_from_depth)
            normal = turned(surface.normals.reshape(3, -1)[:, where], world_from_depth).mean(1)
            out[label] = _form(points, normal, room, bool(supported[label]))
    return out


def _form(points: NDArray[np.float64], normal: NDArray[np.float64], room: Room, supported: bool) -> Form:
    low, high = np.percentile(points, (2, 98), axis=1)
    largest = float((high - low).max())
    size = "small" if largest < 0.3 else "large" if largest > 1.2 else ""
    upward = abs(along(normal, room.up))
    if float(np.sqrt((normal * normal).sum())) < 0.93:
        thing = "object"
    else:
        thing = "horizontal surface" if upward > 0.85 else "vertical surface" if upward < 0.25 else "sloping surface"
    return Form(size, thing, _place(points, thing, room, supported))


def _place(points: NDArray[np.float64], thing: str, room: Room, supported: bool) -> str:
    floor = room.floor
    bottom = None if floor is None else float(np.percentile(along(points, room.up), 5)) - floor.offset
    band = None if bottom is None else 0 if bottom < 0.15 else 1 if bottom < 0.55 else 2 if bottom < 1.1 else 3
    if band is not None and thing == "horizontal surface":
        return ("on the floor", "at knee height", "at table height", "high up")[band]
    if band is not None and (band == 0 or supported):
        return ("on the floor", "on a low surface", "on a table-high surface", "on a high surface")[band]
    if any(float(np.median(along(points, wall.normal))) - wall.offset < 0.12 for wall in room.walls):
        return "on the wall"
    return ""


def _supported(labels: Labels, surface: Surface, room: Room, world_from_depth: Pose) -> Flags:
    """For each label, whether below much of its lower edge something near faces up: it stands there."""
    count = int(labels.max()) + 1
    faces_up = dot(surface.normals, room.up_in(world_from_depth)) > 0.8
    above, below = pair(labels, "y", SUPPORT_GAP)
    edge = (above > 0) & (above != below) & pair(surface.valid, "y", SUPPORT_GAP)[1]
    upper, lower = pair(surface.points, "y", SUPPORT_GAP)
    gap = lower - upper
    held = edge & pair(faces_up, "y", SUPPORT_GAP)[1] & (dot(gap, gap) < 0.08**2)
    edges = np.bincount(above[edge], minlength=count)
    result: Flags = np.bincount(above[held], minlength=count) > 0.3 * np.maximum(edges, 1)
    return result
