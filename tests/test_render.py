"""Rendering a map from a pose: what each pixel sees first."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from openvox.core.types import Intrinsics
from openvox.view.render import NEAR, render_map, render_rows, take_rows

CAMERA = Intrinsics(9, 7, 4.0, 4.0, 4.0, 3.0)  # pixel (4, 3) looks straight ahead
FORWARD = np.eye(4)  # camera axes = world axes: x right, y down, z forward


def at(x: float, y: float, z: float) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, 3] = (x, y, z)
    return pose


def voxels(*index: tuple[int, int, int]) -> NDArray[np.int32]:
    return np.array(index, np.int32).reshape(-1, 3)


def test_a_cube_ahead_covers_the_pixels_whose_rays_meet_it() -> None:
    # eye in the middle of the cell's face plane: the cube spans x, y in [-0.5, 0.5] and z in [2, 3] metres;
    # its near face reaches 4 * 0.5 / 2 = 1 pixel to each side of (4, 3)
    image = render_rows(voxels((0, 0, 2)), 1.0, at(0.5, 0.5, 0.0), CAMERA)
    expected = np.full((7, 9), -1)
    expected[2:5, 3:6] = 0
    assert image.tolist() == expected.tolist()


def test_the_nearer_of_two_cubes_is_seen_whatever_their_order_in_the_map() -> None:
    near, far = (0, 0, 2), (0, 0, 5)
    assert render_rows(voxels(near, far), 1.0, at(0.5, 0.5, 0.0), CAMERA)[3, 4] == 0
    assert render_rows(voxels(far, near), 1.0, at(0.5, 0.5, 0.0), CAMERA)[3, 4] == 1


def test_a_background_voxel_hides_what_lies_behind_it() -> None:
    image = render_map(voxels((0, 0, 2), (0, 0, 5)), np.array([0, 7], np.int32), 1.0, at(0.5, 0.5, 0.0), CAMERA)
    assert image[3, 4] == 0
    assert 7 not in image


def test_a_ray_along_a_shared_face_sees_the_lower_row() -> None:
    # the eye stands at x = 1, the plane between the two cells: the middle column touches both
    image = render_rows(voxels((1, 0, 2), (0, 0, 2)), 1.0, at(1.0, 0.5, 0.0), CAMERA)
    assert image[3].tolist() == [-1, -1, 1, 1, 0, 0, 0, -1, -1]


def test_what_lies_behind_the_camera_or_before_the_near_plane_is_not_drawn() -> None:
    assert (render_rows(voxels((0, 0, -3)), 1.0, at(0.5, 0.5, 0.0), CAMERA) == -1).all()
    small = NEAR / 2
    assert (render_rows(voxels((0, 0, 0)), small, at(small / 2, small / 2, 0.0), CAMERA) == -1).all()


def test_a_cube_through_the_near_plane_is_drawn_from_there_on() -> None:
    # the eye is inside the cell: every ray leaves it far beyond the near plane
    assert (render_rows(voxels((0, 0, 0)), 1.0, at(0.5, 0.5, 0.5), CAMERA) == 0).all()


def test_an_empty_map_shows_nothing() -> None:
    empty = voxels()
    assert (render_rows(empty, 0.04, FORWARD, CAMERA) == -1).all()
    assert (render_map(empty, np.zeros(0, np.int32), 0.04, FORWARD, CAMERA) == -1).all()


def test_one_row_image_serves_any_value_of_a_voxel() -> None:
    rows = np.array([[1, -1], [0, 1]], np.int32)
    assert take_rows(np.array([0.25, 0.5], np.float32), rows, 0.0).tolist() == [[0.5, 0.0], [0.25, 0.5]]


def rays(pose: NDArray[np.float64], camera: Intrinsics) -> NDArray[np.float64]:
    """(height, width, 3) world directions with depth 1."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], 2) @ pose[:3, :3].T


def entry(cell: NDArray[np.int32], size: float, pose: NDArray[np.float64], camera: Intrinsics) -> NDArray[np.float64]:
    """Depth at which each pixel's ray enters the cell; infinite where it misses."""
    with np.errstate(divide="ignore"):
        bounds = (np.stack([cell, cell + 1]) * size - pose[:3, 3])[:, None, None] / rays(pose, camera)
    enter, leave = bounds.min(0).max(2).clip(NEAR), bounds.max(0).min(2)
    return np.where(enter <= leave, enter, np.inf)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60))
def test_each_pixel_sees_the_cell_that_its_ray_enters_first(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.unique(rng.integers(-5, 5, (count, 3)).astype(np.int32), axis=0)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = rng.uniform(-1, 1, 3)
    depth = np.stack([entry(cell, 0.3, pose, CAMERA) for cell in cells])
    image = render_rows(cells, 0.3, pose, CAMERA)
    assert np.array_equal(image < 0, np.isinf(depth).all(0))
    seen = np.take_along_axis(depth, np.maximum(image, 0)[None], 0)[0]
    hit = image >= 0
    assert seen[hit] == pytest.approx(depth.min(0)[hit], abs=1e-9)
