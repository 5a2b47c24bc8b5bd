"""How well frames agree: points of one, carried into another by the poses, should lie on what that one measured.

A point's agreement falls from 1 to 1/2 where it is `TOLERANCE` of its depth off, and is 0 where it leaves the picture
or nothing was measured. A pair's is the mean over its points, both ways. Occluded points count as 0 under every
assumption, so that figures are compared, never read alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.apps.examining.sample import Floats, Sample

TOLERANCE = 0.025
"""Of the depth. Relative, so that no unit is at an advantage."""
GAPS = (1, 2, 4, 8, 16, 32)
"""Frames between the two of a pair: what moves slowly shows over many, what moves fast over few."""
PAIRS = 10
"""Of each gap."""
ROWS, COLUMNS = 18, 24
"""Points of a frame."""
_NEAR = 1e-6


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of frames of a sample and their points, ready to be carried over."""

    sample: Sample
    a: NDArray[np.int64]
    """(p,): the earlier frames."""
    b: NDArray[np.int64]
    u: NDArray[np.int64]
    """(k,): pixels of the points."""
    v: NDArray[np.int64]

    @property
    def gap(self) -> NDArray[np.int64]:
        """(p,): frames from one to the other."""
        return self.b - self.a


def find_pairs(sample: Sample) -> Pairs:
    """The same pairs for the same frames; none over the border of a block."""
    found: list[tuple[int, int]] = []
    for gap in GAPS:
        firsts = np.flatnonzero(sample.block[gap:] == sample.block[:-gap]) if gap < len(sample) else np.zeros(0, int)
        chosen = firsts[np.unique(np.linspace(0, len(firsts) - 1, min(PAIRS, len(firsts))).astype(int))]
        found += [(int(i), int(i) + gap) for i in chosen]
    height, width = sample.depth.shape[1:]
    rows, columns = (np.unique(np.linspace(n // 40, n - 1 - n // 40, k).astype(int)) for n, k in
                     ((height, ROWS), (width, COLUMNS)))  # fmt: skip
    v, u = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    pairs = np.array(found, np.int64).reshape(-1, 2)
    return Pairs(sample, pairs[:, 0], pairs[:, 1], u, v)


def agreement(pairs: Pairs, pose: Floats, *, scale: float = 1.0, focal: float = 1.0) -> Floats:
    """(p,): of each pair, if these were the poses (n, 4, 4), depth were `scale` times as large, focal lengths too."""
    pose = pose.copy()
    pose[:, :3, 3] /= scale  # as good as scaling depth, and the tolerance stays what it is
    forth = _one_way(pairs, pairs.a, pairs.b, pose, focal)
    back = _one_way(pairs, pairs.b, pairs.a, pose, focal)
    return (forth + back) / 2.0


def _one_way(pairs: Pairs, a: NDArray[np.int64], b: NDArray[np.int64], pose: Floats, focal: float) -> Floats:
    depth, camera = pairs.sample.depth, pairs.sample.camera
    fx, fy = camera.fx * focal, camera.fy * focal
    z = depth[a][:, pairs.v, pairs.u] / 1000.0
    points = np.stack([(pairs.u - camera.cx) / fx * z, (pairs.v - camera.cy) / fy * z, z], -1)
    turn = np.swapaxes(pose[b][:, :3, :3], 1, 2)
    moved = points @ np.swapaxes(turn @ pose[a][:, :3, :3], 1, 2)
    moved += (turn @ (pose[a] - pose[b])[:, :3, 3:])[:, None, :, 0]
    ahead = np.maximum(moved[..., 2], _NEAR)
    with np.errstate(over="ignore"):
        u, v = fx * moved[..., 0] / ahead + camera.cx, fy * moved[..., 1] / ahead + camera.cy
    inside = (z > 0) & (moved[..., 2] > _NEAR)
    inside &= (u > -0.5) & (u < camera.width - 0.5) & (v > -0.5) & (v < camera.height - 0.5)
    column, row = (np.rint(np.where(inside, x, 0.0)).astype(np.int64) for x in (u, v))
    there = depth[b[:, None], row, column] / 1000.0
    off = (ahead - there) / (TOLERANCE * ahead)
    agrees = np.where(inside & (there > 0), 1.0 / (1.0 + off * off), 0.0)
    measured: Floats = np.maximum((z > 0).sum(1), 1)
    total: Floats = agrees.sum(1)
    return total / measured
