"""A surface cut into pieces along depth steps and concave creases, the room's planes left out.

Labels are pictures of int32, 0 = no piece, at the surface's working resolution.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Pose
from openvox.perception.parameters import GeometryParameters
from openvox.perception.planes import Room, in_world, turned
from openvox.perception.surface import Axis, Flags, Floats, Surface, dot, pair

Labels = NDArray[np.int32]
AXES: tuple[Axis, Axis] = ("x", "y")
CUT_GAP = 2
MERGE_GAP = 3
GROW_ROUNDS = 6
SMALL_SMOOTH = 0.4
"""Share of the border that must be smooth for a small piece to join."""


def segments(
    surface: Surface, background: Flags, parameters: GeometryParameters, least: int | None = None
) -> tuple[Labels, int]:
    """Pieces of what is not background, numbered from 1, and their number; higher labels are left-overs.

    least: pixels of a left-over, by default those of a region."""
    foreground = surface.valid & ~background
    labels = _seeds(foreground & ~_cuts(surface, parameters), parameters.piece_pixels)
    labels = _grown(labels, foreground, surface.points[2])
    labels = _merged(labels, surface, parameters)
    if not parameters.residue:
        return labels, int(labels.max())
    return _with_residue(labels, foreground, surface.points[2], parameters, least or parameters.residue_pixels)


def background_of(surface: Surface, room: Room, world_from_depth: Pose) -> Flags:
    """Where the surface is one of the room's planes, or behind it."""
    return planes_at(surface, room, world_from_depth) > 0


def planes_at(surface: Surface, room: Room, world_from_depth: Pose) -> NDArray[np.int8]:
    """(h, w): which of the room's planes the surface is, or is behind, the last that fits; from 1, 0 = none."""
    out = np.zeros(surface.valid.shape, np.int8)
    where = np.flatnonzero(surface.valid)
    points = in_world(surface.points.reshape(3, -1)[:, where], world_from_depth)
    normals = turned(surface.normals.reshape(3, -1)[:, where], world_from_depth)
    z = surface.points[2].reshape(-1)[where]
    reach = 0.03 + 0.006 * z * z
    numbers = np.zeros(len(where), np.int8)
    for number, plane in enumerate(room.planes, 1):
        a, b, c = plane.normal
        height = points[0] * a + points[1] * b + points[2] * c - plane.offset
        agree = normals[0] * a + normals[1] * b + normals[2] * c > 0.82
        numbers[((height < reach) & agree) | (np.abs(height) < 0.015)] = number
    out.reshape(-1)[where] = numbers
    return out


def tolerance(z: Floats, parameters: GeometryParameters) -> Floats:
    """How far a point may lie off a surface at that depth before it counts as off it, metres."""
    result: Floats = np.float32(parameters.tolerance) + np.float32(parameters.tolerance_growth) * z * z
    return result


def _relation(surface: Surface, axis: Axis, gap: int, parameters: GeometryParameters) -> tuple[Flags, Flags, Flags]:
    """For pixels `gap` apart: whether there is a depth step, a concave crease, a smooth or convex passage between."""
    p, q = pair(surface.points, axis, gap)
    n, m = pair(surface.normals, axis, gap)
    d = q - p
    off_p, off_q = dot(d, n), dot(d, m)  # of q above the surface at p; of p below the surface at q
    jump = np.abs(d[2])
    allowed = tolerance(p[2], parameters)
    far_p, far_q = np.abs(off_p), np.abs(off_q)
    step = (np.minimum(far_p, far_q) > allowed) & (jump > allowed)
    concave = (off_p > 0) & (off_q < 0) & (dot(n, m) < np.float32(parameters.crease))
    convex = (off_p < 0) & (off_q > 0) & (jump < 3 * allowed)
    smooth = ((far_p < allowed) & (far_q < allowed)) | convex
    return step, concave, smooth & ~concave


def _cuts(surface: Surface, parameters: GeometryParameters) -> Flags:
    """Pixels on either side of a depth step or in a concave crease; convex edges are never cut."""
    out = np.zeros_like(surface.valid)
    for axis in AXES:
        step, concave, _ = _relation(surface, axis, CUT_GAP, parameters)
        both = np.logical_and(*pair(surface.valid, axis, CUT_GAP))
        cut = (step | concave) & both
        for side in pair(out, axis, CUT_GAP):
            side |= cut
    return out


def _seeds(free: Flags, min_pixels: int) -> Labels:
    import cv2

    opened = np.asarray(cv2.morphologyEx(free.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
    return components(opened, 4, min_pixels)


def components(image: NDArray[np.uint8], connectivity: int, min_pixels: int) -> Labels:
    """Connected parts of what is not 0, of at least so many pixels, numbered from 1."""
    import cv2

    _, labels, stats, _ = cv2.connectedComponentsWithStats(image, connectivity=connectivity, ltype=cv2.CV_32S)
    keep = np.asarray(stats)[:, cv2.CC_STAT_AREA] >= min_pixels
    keep[0] = False
    return renumbered(np.asarray(labels, np.int32), keep)


def renumbered(labels: Labels, keep: Flags) -> Labels:
    """The labels that are kept, numbered from 1 in the same order."""
    table = np.where(keep, np.cumsum(keep), 0).astype(np.int32)
    result: Labels = table[labels]
    return result


def _grown(labels: Labels, foreground: Flags, z: Floats) -> Labels:
    """Pieces spread into the cut pixels beside them, not across a step in depth."""
    limit = 0.02 + 0.01 * z
    passages = []
    for axis in AXES:
        a, b = pair(z, axis, 1)
        passages.append((axis, np.abs(a - b) < pair(limit, axis, 1)[0]))
    for _ in range(GROW_ROUNDS):
        labels = _spread(labels, foreground, passages)
    return labels


def _spread(labels: Labels, foreground: Flags, passages: list[tuple[Axis, Flags]]) -> Labels:
    out = labels.copy()
    for axis, near in passages:
        first, second = pair(labels, axis, 1)
        out_first, out_second = pair(out, axis, 1)
        free_first, free_second = pair(foreground, axis, 1)
        np.copyto(out_second, first, where=(out_second == 0) & free_second & near)
        np.copyto(out_first, second, where=(out_first == 0) & free_first & near)
    return out


def _merged(labels: Labels, surface: Surface, parameters: GeometryParameters) -> Labels:
    """Pieces whose common border is mostly smooth become one."""
    count = int(labels.max()) + 1
    keys, smooths, concaves = [], [], []
    for axis in AXES:
        a, b = pair(labels, axis, MERGE_GAP)
        at = (a != b) & (a > 0) & (b > 0)
        _, concave, smooth = _relation(surface, axis, MERGE_GAP, parameters)
        keys.append(np.minimum(a[at], b[at]).astype(np.int64) * count + np.maximum(a[at], b[at]))
        smooths.append(smooth[at])
        concaves.append(concave[at])
    borders, which = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.bincount(which)
    smooth_share = np.bincount(which, np.concatenate(smooths)) / total
    concave_share = np.bincount(which, np.concatenate(concaves)) / total
    area = np.bincount(labels.reshape(-1), minlength=count)
    parent = list(range(count))
    for border, smooth, concave in zip(borders.tolist(), smooth_share.tolist(), concave_share.tolist(), strict=True):
        a, b = divmod(border, count)
        needed = SMALL_SMOOTH if min(area[a], area[b]) < parameters.piece_pixels else parameters.merge_smooth
        if smooth > needed and concave < parameters.merge_concave:
            join(parent, a, b)
    table = np.array([root(parent, i) for i in range(count)], np.int32)
    roots = table == np.arange(count)
    roots[0] = False
    return renumbered(table[labels], roots)


def root(parent: list[int], i: int) -> int:
    """The number that stands for all that `join` joined to i."""
    while parent[i] != i:
        i = parent[i]
    return i


def join(parent: list[int], a: int, b: int) -> None:
    """Make a and b one; the lower root stands for both."""
    low, high = sorted((root(parent, a), root(parent, b)))
    parent[high] = low


def _with_residue(
    labels: Labels, foreground: Flags, z: Floats, parameters: GeometryParameters, least: int
) -> tuple[Labels, int]:
    """Also what was too torn for pieces (foliage, thin legs): left-over foreground between jumps in depth."""
    import cv2

    area = np.bincount(labels.reshape(-1))
    small = area < parameters.piece_pixels
    small[0] = True
    rest = foreground & small[labels]
    edges = np.zeros_like(rest)
    for axis in AXES:
        a, b = pair(z, axis, 1)
        jump = np.abs(a - b) > 0.08
        for side in pair(edges, axis, 1):
            side |= jump
    around = np.ones((3, 3), np.uint8)
    loose = np.asarray(cv2.dilate((rest & ~edges).astype(np.uint8), around), np.uint8) * rest
    kept = renumbered(labels, ~small)
    residue = components(loose, 8, least)
    pieces = int(kept.max())
    return np.where(residue > 0, residue + pieces, kept).astype(np.int32), pieces
