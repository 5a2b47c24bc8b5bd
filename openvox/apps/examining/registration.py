"""Colour and depth: edges of depth, taken over into the colour picture, should lie on edges of colour.

The colour camera is turned and its focal length changed until they lie best; far from as it is said to be, it is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from openvox.apps.examining.finding import Finding
from openvox.apps.examining.sample import Floats, Sample
from openvox.core.errors import InputError
from openvox.core.types import DepthImage, Frame, Intrinsics
from openvox.formats.images import decode_color

COLUMNS = 320
"""Of the working pictures."""
REACH, STEP = 3, 0.06
"""Pixels to the side within which depth rises by that share: an edge, and the near side of it."""
FEWEST_EDGES = 400
"""Edge pixels of all pictures together, below which nothing is said."""
SEARCH = 0.25
"""Of the picture's width: how far a shift is looked for."""
FOCALS = (0.75, 0.8, 0.85, 0.9, 0.95, 1.05, 1.1, 1.15, 1.2, 1.3)
ROLLS = (-15.0, -12.0, -9.0, -6.0, -3.0, 3.0, 6.0, 9.0, 12.0, 15.0)
GAIN = 1.3
"""Times the match within a pixel or two of as it is; the good recordings stay below 1.15."""
CLEAR = 5.0
"""Standard deviations of the match over all shifts by which the best one must stand out; good ones have 10 to 20."""
SMALLEST = 0.0125
"""Of the width: a smaller shift of the edges is within what depth edges fray (8 of 640 pixels)."""


@dataclass(frozen=True, eq=False)
class Edges:
    """One frame: where colour has edges, and the points of depth edges."""

    color: NDArray[np.float32]
    """(h, w): strength, about 0 in the mean."""
    points: Floats
    """(n, 3): in the colour camera as it is said to sit, metres."""
    camera: Intrinsics
    """Of `color`."""

    def pixels(self, turn: Rotation | None = None, focal: float = 1.0) -> Floats:
        """(n, 2): the points in the picture, the camera turned and its focal length changed."""
        points = self.points if turn is None else turn.apply(self.points)
        ahead = np.maximum(points[:, 2], 1e-6)
        c = self.camera
        u, v = focal * c.fx * points[:, 0] / ahead + c.cx, focal * c.fy * points[:, 1] / ahead + c.cy
        return np.stack([u, v], -1)


def examine_registration(sample: Sample) -> tuple[list[Finding], list[str]]:
    """At most one finding, and notes."""
    if not sample.pictures:
        return [], []
    edges = [found for frame in sample.pictures if (found := edges_of(frame)) is not None]
    if sum(len(one.points) for one in edges) < FEWEST_EDGES:
        return [], ["depth has too few edges to see whether colour lies on it"]
    turn, focal, clear = _best(edges)
    moved = max(_moved(one, turn, focal) for one in edges)
    here, there = _nearby(edges), _match(edges, turn, focal)
    if clear < CLEAR or moved < SMALLEST or there < GAIN * max(here, 1e-6):
        return [], []
    halves = [_match(half, turn, focal) > GAIN * max(_nearby(half), 1e-6) for half in (edges[::2], edges[1::2]) if half]
    return ([_finding(sample, turn, focal, moved, here, there)] if all(halves) else []), []


def edges_of(frame: Frame) -> Edges | None:
    """None where colour cannot be decoded or depth has no edge."""
    import cv2

    try:
        grey = cv2.cvtColor(decode_color(frame), cv2.COLOR_RGB2GRAY)
    except InputError:
        return None
    camera = _scaled(frame.rig.color)
    small = cv2.resize(grey, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    points = _edge_points(frame)
    if not len(points):
        return None
    return Edges(_strength(np.asarray(small, np.uint8)), points, camera)


def _scaled(camera: Intrinsics) -> Intrinsics:
    s = min(1.0, COLUMNS / camera.width)
    width, height = round(camera.width * s), max(1, round(camera.height * s))
    return Intrinsics(
        width, height, camera.fx * s, camera.fy * s, (camera.cx + 0.5) * s - 0.5, (camera.cy + 0.5) * s - 0.5
    )


def _strength(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Edges against their surroundings: a strong texture counts no more than the outline of a wall."""
    import cv2

    across, down = (cv2.Scharr(grey, cv2.CV_32F, *way) for way in ((1, 0), (0, 1)))
    size = np.hypot(across, down)
    size = np.minimum(size / (cv2.GaussianBlur(size, (0, 0), 16) + 30.0), 3.0)
    size -= cv2.GaussianBlur(size, (0, 0), 24)
    return np.asarray(size - size.mean(), np.float32)


def _edge_points(frame: Frame) -> Floats:
    """(n, 3): the near side of depth edges, in the colour camera."""
    camera = frame.rig.depth
    step = max(1, round(camera.width / COLUMNS))
    rows, columns = np.nonzero(near_sides(frame.depth[::step, ::step]))
    u, v = columns * step, rows * step
    z = frame.depth[v, u] / 1000.0
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], -1)
    color_from_depth = np.linalg.inv(frame.rig.depth_from_color.matrix())
    moved: Floats = points @ color_from_depth[:3, :3].T + color_from_depth[:3, 3]
    return moved[moved[:, 2] > 0.05]


def near_sides(depth: DepthImage) -> NDArray[np.bool_]:
    """(h, w): pixels beside which, within REACH, something clearly farther is measured."""
    near = np.zeros(depth.shape, np.bool_)
    limit = depth * (1.0 + STEP) + 20.0
    for dv, du in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        for k in range(1, REACH + 1):
            near |= np.roll(depth, (dv * k, du * k), (0, 1)) > limit
    near &= depth > 0
    for edge in (np.s_[:REACH], np.s_[-REACH:], np.s_[:, :REACH], np.s_[:, -REACH:]):
        near[edge] = False
    return near


def _match(
    edges: Sequence[Edges], turn: Rotation | None = None, focal: float = 1.0, shift: Floats | None = None
) -> float:
    """Mean strength of colour under the points, 0 for those that leave the picture."""
    total, count = 0.0, 0
    for one in edges:
        pixels = one.pixels(turn, focal) + (0.0 if shift is None else shift)
        h, w = one.color.shape
        inside = (pixels > -0.5).all(1) & (pixels[:, 0] < w - 0.5) & (pixels[:, 1] < h - 0.5)
        u, v = np.rint(pixels[inside]).astype(np.int64).T
        total += float(one.color[v, u].sum())
        count += len(pixels)
    return total / max(count, 1)


def _nearby(edges: Sequence[Edges]) -> float:
    """The best match within two pixels of as it is: depth edges fray to one side."""
    grid = np.stack(np.meshgrid(range(-2, 3), range(-2, 3)), -1).reshape(-1, 2)
    return max(_match(edges, shift=shift) for shift in grid)


def _best(edges: Sequence[Edges]) -> tuple[Rotation, float, float]:
    """The turn and focal factor of the best match, and how clearly its shift stands out among all shifts."""
    trials = [(0.0, 1.0), *((0.0, focal) for focal in FOCALS), *((roll, 1.0) for roll in ROLLS)]
    found = []
    spectra = [_spectrum(one) for one in edges]
    for roll, focal in trials:
        (dx, dy), match, clear = _shift(edges, spectra, Rotation.from_euler("z", roll, degrees=True), focal)
        camera = edges[0].camera
        tilt = Rotation.from_rotvec([-np.arctan(dy / camera.fy), np.arctan(dx / camera.fx), 0.0])
        found.append((match, clear, tilt * Rotation.from_euler("z", roll, degrees=True), focal))
    _, clear, turn, focal = max(found, key=lambda one: one[0])
    turn, focal = _refined(edges, turn, focal)
    return turn, focal, clear


def _padded(one: Edges) -> tuple[list[int], int]:
    """The size of the picture with room for shifts, and how far they go."""
    from scipy import fft

    reach = max(2, round(SEARCH * one.camera.width))
    return [fft.next_fast_len(n + reach, real=True) for n in one.color.shape], reach


def _spectrum(one: Edges) -> NDArray[np.complex64]:
    from scipy import fft

    return np.asarray(fft.rfft2(one.color, _padded(one)[0]), np.complex64)


def _shift(
    edges: Sequence[Edges], spectra: Sequence[NDArray[np.complex64]], turn: Rotation, focal: float
) -> tuple[tuple[int, int], float, float]:
    """The shift (x, y) of the points that matches best, its match, and that in standard deviations over all shifts."""
    import cv2
    from scipy import fft

    total: NDArray[np.float32] | None = None
    around = np.arange(-_padded(edges[0])[1], _padded(edges[0])[1] + 1)
    for one, spectrum in zip(edges, spectra, strict=True):
        h, w = one.color.shape
        size, _ = _padded(one)
        pixels = one.pixels(turn, focal)
        marks, _, _ = np.histogram2d(pixels[:, 1], pixels[:, 0], (h, w), ((-0.5, h - 0.5), (-0.5, w - 0.5)))
        blurred = cv2.GaussianBlur(marks.astype(np.float32), (0, 0), 1.0)
        match = fft.irfft2(spectrum * np.conj(fft.rfft2(blurred, size)), size)
        part = match[np.ix_(around % size[0], around % size[1])]
        total = part if total is None else total + part
    assert total is not None
    at = np.unravel_index(int(total.argmax()), total.shape)
    best = float(total[at])
    spread = float(total.std())
    count = sum(len(one.points) for one in edges)
    return (int(around[at[1]]), int(around[at[0]])), best / count, best / max(spread, 1e-9)


def _refined(edges: Sequence[Edges], turn: Rotation, focal: float) -> tuple[Rotation, float]:
    """Ever smaller turns and focal changes."""
    top = _match(edges, turn, focal)
    for degrees, factor in ((1.6, 1.03), (0.8, 1.015), (0.4, 1.008), (0.2, 1.004)):
        for _ in range(4):
            begun = top
            trials = [(Rotation.from_rotvec(np.radians(degrees) * axis) * turn, focal)
                      for axis in np.vstack([np.eye(3), -np.eye(3)])]  # fmt: skip
            trials += [(turn, focal * factor), (turn, focal / factor)]
            for trial in trials:
                if (found := _match(edges, *trial)) > top:
                    top, (turn, focal) = found, trial
            if top == begun:
                break
    return turn, focal


def _moved(one: Edges, turn: Rotation, focal: float) -> float:
    """How far the points move in the picture, in the mean, of its width."""
    before, after = one.pixels(), one.pixels(turn, focal)
    return float(np.linalg.norm(after - before, axis=1).mean()) / one.camera.width


def _finding(sample: Sample, turn: Rotation, focal: float, moved: float, here: float, there: float) -> Finding:
    rig, degrees = sample.rig, np.degrees(turn.magnitude())
    width = rig.color.width
    parts = [f"the colour camera turned by {degrees:.1f} degrees"] if degrees > 0.5 else []
    parts += [f"its focal length times {focal:.3f}"] if abs(np.log(focal)) > 0.01 else []
    color_from_depth = np.linalg.inv(rig.depth_from_color.matrix())
    fixed = np.eye(4)
    fixed[:3, :3] = turn.as_matrix()
    rows = " / ".join(" ".join(f"{value:.4f}" for value in row) for row in fixed @ color_from_depth)
    cures = [f"openvox ingest with --color-from-depth FILE with the lines {rows}"] if degrees > 0.5 else []
    if abs(np.log(focal)) > 0.01:
        cures.append(
            f"the colour camera's own intrinsics in the source (about fx {rig.color.fx * focal:.0f}, fy "
            f"{rig.color.fy * focal:.0f}; of some sources: openvox ingest with --camera FILE)"
        )
    cures.append("best is depth registered to colour by the camera's driver")
    return Finding(
        "registration",
        f"Colour does not lie on depth: edges are about {moved * width:.0f} pixels apart.",
        f"edges of depth lie on edges of colour by {here:.2f} as it is, by {there:.2f} with {' and '.join(parts)}",
        "depth is of another camera than colour and was not registered to it, or the transform between them is wrong",
        "; ".join(cures),
    )
