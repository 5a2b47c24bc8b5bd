"""From a working picture's labels to regions in the pixels of the colour image."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import DepthImage, Rig
from openvox.perception.segments import Labels
from openvox.perception.surface import Floats, Surface, phases

Doubles = NDArray[np.float64]
_NOTHING = np.uint32(0xFFFFFFFF)


def at_depth_pixels(labels: Labels, surface: Surface, z: Floats) -> Labels:
    """Labels at the depth image's own pixels: that of the nearest working pixel, or of one beside it nearer in depth.

    z: (height, width) metres, 0 = no measurement. Returns (height, width) int32."""
    h, w = labels.shape
    near_labels, near_z = np.pad(labels, 1, mode="edge"), np.pad(surface.points[2], 1, mode="edge")
    out = np.zeros((h * surface.step, w * surface.step), np.int32)
    for (py, px), own in phases(z, surface.step).items():
        best = np.where(own > 0, np.abs(surface.points[2] - own) - 0.01 * own, -np.inf)
        chosen = labels.copy()
        for dy in _sides(py, surface.step):
            for dx in _sides(px, surface.step):
                off = np.abs(near_z[1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w] - own)
                better = off < best
                np.copyto(best, off, where=better)
                np.copyto(chosen, near_labels[1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w], where=better)
        out[py :: surface.step, px :: surface.step] = chosen
    return out[: z.shape[0], : z.shape[1]]


def _sides(phase: int, step: int) -> tuple[int, ...]:
    """The working pixel itself, and the one beside it on the side where the pixel lies."""
    middle = (step - 1) / 2
    return (0,) if phase == middle else (0, -1) if phase < middle else (0, 1)


def at_color_pixels(labels: Labels, depth: DepthImage, rig: Rig) -> Labels:
    """Labels of depth pixels carried into the colour image, where the smaller depth wins; small holes are closed.

    labels: (height, width) of the depth camera. Returns that of the colour camera."""
    if rig.registered:
        return labels
    front = _front(labels, depth, rig)
    return np.where(front == _NOTHING, 0, front & np.uint32(0xFFFF)).astype(np.int32)


def depth_at_color_pixels(depth: DepthImage, rig: Rig) -> Floats:
    """(height, width) metres of what each colour pixel shows, 0 where the depth camera did not measure it."""
    if rig.registered:
        return depth.astype(np.float32) * np.float32(0.001)
    front = _front(np.zeros(depth.shape, np.int32), depth, rig)
    return np.where(front == _NOTHING, 0, front >> np.uint32(16)).astype(np.float32) * np.float32(0.001)


def color_pixels_of(surface: Surface, rig: Rig) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(h, w) row and column of the colour pixel that shows each working pixel's point, the rim's where none does."""
    h, w = surface.valid.shape
    if rig.registered:
        rows = np.arange(h)[:, None] * surface.step + np.zeros(w, np.int64)
        columns = np.arange(w) * surface.step + np.zeros((h, 1), np.int64)
    else:
        x, y, z = surface.points.astype(np.float64)
        u, v, _ = _in_color_camera(x, y, z, rig)
        rows, columns = np.rint(v).astype(np.int64), np.rint(u).astype(np.int64)
    return rows.clip(0, rig.color.height - 1), columns.clip(0, rig.color.width - 1)


def _front(labels: Labels, depth: DepthImage, rig: Rig) -> NDArray[np.uint32]:
    """Millimetres << 16 | label of the nearest thing at each colour pixel, _NOTHING where there is none."""
    color, step = rig.color, max(1, math.ceil(rig.color.fx / rig.depth.fx), math.ceil(rig.color.fy / rig.depth.fy))
    height, width = -(-color.height // step), -(-color.width // step)
    u, v, z = _projected(depth, rig)
    with np.errstate(invalid="ignore"):
        column, row = np.rint((u - (step - 1) / 2) / step), np.rint((v - (step - 1) / 2) / step)
        inside = (z > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    place = (row[inside] * width + column[inside]).astype(np.int64)
    key = np.rint(np.minimum(z[inside], 65.0) * 1000).astype(np.uint32) << np.uint32(16)
    key |= labels[inside].astype(np.uint32)
    front = np.full(height * width, _NOTHING, np.uint32)
    np.minimum.at(front, place, key)
    front = _closed(front.reshape(height, width))
    return front.repeat(step, 0).repeat(step, 1)[: color.height, : color.width]


def _projected(depth: DepthImage, rig: Rig) -> tuple[Doubles, Doubles, Doubles]:
    """Column and row in the colour image and depth in its camera of every depth pixel; depth 0 where there is none."""
    z = depth.astype(np.float64) * 0.001
    x = (np.arange(rig.depth.width) - rig.depth.cx) / rig.depth.fx * z
    y = ((np.arange(rig.depth.height) - rig.depth.cy) / rig.depth.fy)[:, None] * z
    return _in_color_camera(x, y, z, rig)


def _in_color_camera(x: Doubles, y: Doubles, z: Doubles, rig: Rig) -> tuple[Doubles, Doubles, Doubles]:
    """Column, row and depth in the colour camera of points of the depth camera; depth 0 where there is no point."""
    rows, t = rig.depth_from_color.rotation(), rig.depth_from_color.translation
    x, y, shifted = x - t[0], y - t[1], z - t[2]
    # The inverse of a rotation is its transpose: columns of rows.
    cx, cy, cz = (rows[0][i] * x + rows[1][i] * y + rows[2][i] * shifted for i in range(3))
    there = (z > 0) & (cz > 1e-3)
    cz = np.where(there, cz, 1.0)
    u = cx / cz * rig.color.fx + rig.color.cx
    v = cy / cz * rig.color.fy + rig.color.cy
    return u, v, np.where(there, cz, 0.0)


def _closed(front: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Empty pixels take the nearest thing among their eight neighbours, twice: gaps between projected pixels."""
    for _ in range(2):
        padded = np.pad(front, 1, constant_values=_NOTHING)
        h, w = front.shape
        around = np.minimum.reduce([padded[dy : dy + h, dx : dx + w] for dy in range(3) for dx in range(3)])
        front = np.where(front == _NOTHING, around, front)
    return front
