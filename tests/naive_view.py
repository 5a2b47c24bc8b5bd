"""The slow twin's eyes: a frame's masks and depth pixels to voxels (eq. 6), and its integer arithmetic."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from openvox.core.mapper_parameters import MapperParameters
from openvox.core.types import Frame, Mask, Pose, Rig

Voxel = tuple[int, int, int]
Pixel = tuple[int, int]
ONE = 2**20
MILLION = 10**6


# ---- numbers --------------------------------------------------------------------------------------------------------


def dot(a: Sequence[int], b: Sequence[int]) -> int:
    return sum(x * y for x, y in zip(a, b, strict=True))


def short(vector: Sequence[int]) -> list[int]:
    """All components shifted down until the largest fits 20 bits."""
    shift = max(0, max((abs(x) for x in vector), default=0).bit_length() - 20)
    return [x >> shift for x in vector]


def cosine(a: Sequence[int], b: Sequence[int]) -> int:
    """In parts of 2**20, toward zero; 0 if one is null."""
    squares = dot(a, a) * dot(b, b)
    if squares == 0:
        return 0
    size = math.isqrt(dot(a, b) ** 2 * ONE**2 // squares)
    return size if dot(a, b) >= 0 else -size


def summed(vectors: Iterable[Sequence[int]]) -> list[int]:
    return [sum(column) for column in zip(*vectors, strict=True)]


def strongest(counts: Mapping[int, int], among: Collection[int] | None = None) -> tuple[int, int]:
    """(votes, id) of the id with most votes, the lowest on a tie; (0, 0) if there is none. Background is no id."""
    ranked = [(n, -f) for f, n in counts.items() if f > 0 and (among is None or f in among)]
    votes, negative = max(ranked, default=(0, 0))
    return votes, -negative


# ---- eq. 6: pixels to voxels ----------------------------------------------------------------------------------------


def voxel_of(u: int, v: int, z: int, pose: Pose, rig: Rig, voxel_size: float) -> Voxel:
    """floor(world / voxel_size) of a depth pixel; rays in Q18, rotation in Q28, translation in Q46."""
    x, y = ray(u, v, rig)
    out = []
    for row, metres in zip(pose.rotation(), pose.translation, strict=True):
        a = [round(value / (voxel_size * 1000.0) * 2**28) for value in row]
        position = metres * 1000.0 / (voxel_size * 1000.0)
        whole = math.floor(position)
        fraction = round((position - whole) * 2**46)
        out.append((z * (a[0] * x + a[1] * y + a[2] * 2**18) + fraction) // 2**46 + whole)
    return out[0], out[1], out[2]


def ray(u: int, v: int, rig: Rig) -> Pixel:
    camera = rig.depth
    return round((u - camera.cx) / camera.fx * 2**18), round((v - camera.cy) / camera.fy * 2**18)


def color_pixel(u: int, v: int, z: int, rig: Rig) -> Pixel | None:
    """The nearest colour pixel of a depth pixel; None if the colour camera cannot see the point."""
    if rig.registered:
        return u, v
    x, y = ray(u, v, rig)
    rows, shift = rig.depth_from_color.rotation(), rig.depth_from_color.translation
    point = []
    for column in range(3):
        r = [rows[i][column] for i in range(3)]  # the inverse rotation is the transposed one
        moved = round(-(r[0] * shift[0] + r[1] * shift[1] + r[2] * shift[2]) * 1000.0 * 2**44)
        a = [round(value * 2**26) for value in r]
        point.append((z * (a[0] * x + a[1] * y + a[2] * 2**18) + moved) // 2**28)
    if point[2] <= 0:
        return None
    camera = rig.color
    fx, fy, cx, cy = (round(value * 2**16) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    den = point[2] * 2**16
    column = (2 * (fx * point[0] + cx * point[2]) + den) // (2 * den)
    line = (2 * (fy * point[1] + cy * point[2]) + den) // (2 * den)
    return (column, line) if 0 <= column < camera.width and 0 <= line < camera.height else None


def pixels_of(mask: Mask) -> set[Pixel]:
    x0, y0, _, _ = mask.box
    return {(x0 + int(u), y0 + int(v)) for v, u in np.argwhere(mask.crop())}


def square(pixel: Pixel, radius: int) -> Iterator[Pixel]:
    steps = range(-radius, radius + 1)
    return ((pixel[0] + i, pixel[1] + j) for i in steps for j in steps)


def labels(areas: Mapping[int, set[Pixel]], rig: Rig, p: MapperParameters) -> dict[Pixel, tuple[int, ...] | None]:
    """The masks of each colour pixel: all that cover it, or with one vote the smallest; None = votes for nothing."""
    image: dict[Pixel, tuple[int, ...]] = {(u, v): () for u in range(rig.color.width) for v in range(rig.color.height)}
    alone = p.masks.one_vote or p.masks.disjoint
    for m in sorted(areas, key=lambda m: (-len(areas[m]), m) if alone else (0, m)):
        for pixel in areas[m]:
            image[pixel] = (m,) if alone else (*image[pixel], m)
    if not alone:
        return dict(image)
    if p.masks.disjoint:
        whole = {
            pixel: here if all(image.get(near) == here for near in square(pixel, p.masks.window)) else None
            for pixel, here in image.items()
        }
        left = Counter(whole.values())
        return {pixel: None if here and left[here] < p.masks.min_pixels else here for pixel, here in whole.items()}
    return {
        pixel: None if any(image.get(near, here) != here for near in square(pixel, p.masks.erosion)) else here
        for pixel, here in image.items()
    }


def near_steps(depth: Mapping[Pixel, int], margin: int) -> set[Pixel]:
    """Pixels within `margin` of a depth step: neighbours that differ by over 60 mm + 2 % of the nearer one."""
    out: set[Pixel] = set()
    for (u, v), z in depth.items():
        for neighbour in ((u + 1, v), (u, v + 1)):
            other = depth.get(neighbour, 0)
            if margin and z and other and 100 * abs(z - other) > 100 * 60 + 2 * min(z, other):
                out.update(square((u, v), margin - 1), square(neighbour, margin - 1))
    return out


@dataclass
class View:
    """What a frame sees: the voxels under each mask, those under none, and all."""

    under: list[set[Voxel]]
    bare: set[Voxel]
    all: set[Voxel]
    large: set[int] = field(default_factory=set)
    """Masks of which enough is left."""


def view_of(frame: Frame, masks: int, areas: Mapping[int, set[Pixel]], p: MapperParameters) -> View:
    image = labels(areas, frame.rig, p)
    depth = {(u, v): int(z) for v, row in enumerate(frame.depth) for u, z in enumerate(row)}
    steps = near_steps(depth, p.masks.step_margin if p.masks.one_vote else 0)
    pixels: dict[Voxel, Counter[tuple[int, ...]]] = {}
    for (u, v), z in depth.items():
        if not 0 < z <= int(p.map.max_depth * 1000) or (u, v) in steps:
            continue
        seen_at = color_pixel(u, v, z, frame.rig)
        label = None if seen_at is None else image[seen_at]
        if label is not None:
            voxel = voxel_of(u, v, z, frame.world_from_depth, frame.rig, p.map.voxel_size)
            pixels.setdefault(voxel, Counter())[label] += 1
    view = View([set() for _ in range(masks)], set(), set(pixels))
    for voxel, counts in pixels.items():
        if p.masks.one_vote:  # most pixels; on a tie "no mask", then the smallest mask, then the last
            over: set[int] = set(min(counts, key=lambda label: (-counts[label], *((len(areas[m]), -m) for m in label))))
        else:
            over = {m for label in counts for m in label}
        for m in over:
            view.under[m].add(voxel)
        if not over and (p.evolution.background or p.evolution.veto):
            view.bare.add(voxel)
    left = Counter(image.values())
    view.large = {m for m in areas if not p.masks.disjoint or left[m,] >= p.masks.min_pixels}
    if p.masks.inliers:
        view.under = [inliers(voxels) for voxels in view.under]
    return view


def inliers(voxels: set[Voxel]) -> set[Voxel]:
    """Without those whose mean distance to their ten nearest is 0, or not below the mean by two deviations."""
    apart = {
        here: sum(sorted(math.isqrt(dot(step, step) * ONE) for step in steps(here, voxels))[:10]) for here in voxels
    }
    n, total = len(apart), sum(apart.values())
    squares = sum((n * x - total) ** 2 for x in apart.values())
    return {
        voxel for voxel, x in apart.items() if x > 0 and (n * x < total or (n - 1) * (n * x - total) ** 2 < 4 * squares)
    }


def steps(here: Voxel, voxels: Iterable[Voxel]) -> list[list[int]]:
    return [[a - b for a, b in zip(here, there, strict=True)] for there in voxels]
