"""A depth image as a surface: points with normals in the depth camera's frame, at a working resolution.

Arrays are planes of a picture, (3, h, w) or (h, w). The working picture is about 320 pixels wide, so that a distance
in its pixels means the same for every camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import DepthImage, Intrinsics

WIDTH = 320
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Axis = Literal["x", "y"]


@dataclass(frozen=True, eq=False)
class Surface:
    """`step`: depth pixels to a working pixel. `points`: (3, h, w), metres. `normals`: (3, h, w), unit length, towards
    the camera, 0 where unknown. `valid`: (h, w), where there is a point; elsewhere all is 0."""

    step: int
    points: Floats
    normals: Floats
    valid: Flags


def surface(depth: DepthImage, camera: Intrinsics, near: float, far: float) -> Surface:
    """The surface that a depth image shows between `near` and `far` metres; pinholes are filled."""
    step = working_step(camera)
    z = filled(_pooled(depth_in_metres(depth, near, far), step))
    valid = z > 0
    z = smoothed(z)
    u, v = (np.arange(n, dtype=np.float32) * step + np.float32((step - 1) / 2) for n in (z.shape[1], z.shape[0]))
    x = (u - np.float32(camera.cx)) / np.float32(camera.fx)
    y = (v - np.float32(camera.cy)) / np.float32(camera.fy)
    points = np.stack([x * z, y[:, None] * z, z])
    return Surface(step, points, _normals(points, valid), valid)


def working_step(camera: Intrinsics) -> int:
    """Pixels of that camera to a working pixel, along a side."""
    return max(1, round(camera.width / WIDTH))


def depth_in_metres(depth: DepthImage, near: float, far: float) -> Floats:
    """(height, width), 0 where there is no measurement between `near` and `far`."""
    inside = (depth >= round(near * 1000)) & (depth <= round(far * 1000)) & (depth > 0)
    return np.where(inside, depth.astype(np.float32) * np.float32(0.001), np.float32(0))


def phases(image: NDArray[Any], step: int) -> dict[tuple[int, int], NDArray[Any]]:
    """The step x step pictures of every step-th pixel, by row and column offset; what is missing at the rim is 0."""
    rows, columns = (-side % step for side in image.shape)
    padded = np.pad(image, ((0, rows), (0, columns))) if rows or columns else image
    return {(dy, dx): padded[dy::step, dx::step] for dy in range(step) for dx in range(step)}


def _pooled(z: Floats, step: int) -> Floats:
    """Mean of the measurements in each step x step block that are within 2 % of its nearest."""
    blocks = np.stack(list(phases(z, step).values()))
    nearest = np.where(blocks > 0, blocks, np.float32(np.inf)).min(0)
    sound = (blocks > 0) & (blocks < nearest * np.float32(1.02))
    result: Floats = (blocks * sound).sum(0) / np.maximum(sound.sum(0, dtype=np.float32), 1)
    return result


def filled(z: Floats, rounds: int = 3) -> Floats:
    """Empty pixels with at least three measured neighbours of eight take their mean; dark things are full of holes."""
    import cv2

    for _ in range(rounds):
        valid = (z > 0).astype(np.float32)
        count = cv2.boxFilter(valid, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        total = cv2.boxFilter(z, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        z = np.where((valid == 0) & (count > 2.5), total / np.maximum(count, 1), z)
    return z


def smoothed(z: Floats, gap: int = 2, share: float = 0.02) -> Floats:
    """Mean over the eight neighbours `gap` pixels away that differ by less than `share` of the depth."""
    total, count = z.copy(), np.ones_like(z)
    limit = z * np.float32(share)
    padded = np.pad(z, gap)
    h, w = z.shape
    for dy in (0, gap, 2 * gap):
        for dx in (0, gap, 2 * gap):
            if dy == dx == gap:
                continue
            other = padded[dy : dy + h, dx : dx + w]
            near = np.abs(other - z) < limit
            total += other * near
            count += near
    return total / count


def _normals(points: Floats, valid: Flags, gap: int = 3) -> Floats:
    import cv2

    across, down = _tangent(points, valid, "x", gap), _tangent(points, valid, "y", gap)
    cross = np.stack(
        [
            down[1] * across[2] - down[2] * across[1],
            down[2] * across[0] - down[0] * across[2],
            down[0] * across[1] - down[1] * across[0],
        ]
    )
    _normalise(cross)
    mean = np.stack([cv2.blur(plane, (5, 5)) for plane in cross])
    mean *= valid
    _normalise(mean)
    return mean


def _tangent(points: Floats, valid: Flags, axis: Axis, gap: int) -> Floats:
    """Difference over +-gap pixels; one-sided where the other side jumps in depth or has no point."""
    first, second = pair(points, axis, gap)
    difference = second - first
    jump = 0.045 * first[2] + 0.015
    both = (np.abs(difference[2]) < jump) & np.logical_and(*pair(valid, axis, gap))
    difference *= both
    out = np.zeros_like(points)
    before, after = pair(out, axis, gap)
    before += difference
    after += difference
    return out


def _normalise(vectors: Floats) -> None:
    """In place; where the length is near 0 the vector becomes 0."""
    length = np.sqrt(dot(vectors, vectors))
    vectors *= np.where(length > 1e-9, 1 / np.maximum(length, 1e-9), 0)


def pair(image: NDArray[Any], axis: Axis, gap: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Two views of a picture so that equal places are pixels `gap` apart along an axis, the left or upper one first."""
    if axis == "x":
        return image[..., :-gap], image[..., gap:]
    return image[..., :-gap, :], image[..., gap:, :]


def dot(a: Floats, b: Floats) -> Floats:
    """Scalar product of planes of vectors, in fixed order."""
    result: Floats = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return result
