"""Depth pixels to voxels, by hand, and the look-up of colour pixels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from openvox.core.errors import InputError
from openvox.core.types import Intrinsics, Pose, Rig
from openvox.core.voxels import voxel_index, voxel_key
from openvox.mapper import projection
from openvox.mapper.engines.pixels import color_pixel, count_pixels

CAMERA = Intrinsics(8, 6, 10.0, 10.0, 4.0, 3.0)
LEVEL = (0.0, 0.0, 0.0, 1.0)


def voxels(
    depth: np.ndarray, pose: Pose, rig: Rig, *, registered: bool, size: float = 0.1
) -> list[tuple[list[int], int]]:
    """Voxel index and colour label of every entry; each colour pixel's label is its number in the picture."""
    rays, look_up = projection.pixel_rays(rig.depth), projection.color_lookup(rig, projection.pixel_rays(rig.depth))
    transform = projection.voxel_transform(pose, 0.1, rays, 60000)
    labels = np.arange(rig.color.width * rig.color.height, dtype=np.int32).reshape(rig.color.height, rig.color.width)
    camera = np.array([look_up.fx, look_up.fy, look_up.cx, look_up.cy], np.int64)
    keys, voxel, label, _, enough = count_pixels(
        depth, np.zeros(depth.shape, np.uint8), labels, 60000, rays.x, rays.y, transform.a, transform.b, transform.c,
        registered, look_up.rotation, look_up.translation, camera, 1 << 10,
    )  # fmt: skip
    assert enough
    index = voxel_index(keys)
    return [(index[v].tolist(), int(n)) for v, n in zip(voxel, label, strict=True)]


def one_pixel(u: int, v: int, z: int) -> np.ndarray:
    depth = np.zeros((CAMERA.height, CAMERA.width), np.uint16)
    depth[v, u] = z
    return depth


@pytest.mark.parametrize(
    ("pixel", "z", "translation", "expected"),
    [
        ((4, 3), 1050, (0.0, 0.0, 0.0), [0, 0, 10]),  # straight ahead: 1.05 m
        ((6, 3), 1000, (0.0, 0.0, 0.05), [2, 0, 10]),  # slope 0.2: x = 0.2 m, z = 1.05 m
        ((3, 2), 1000, (0.0, 0.0, 0.05), [-1, -1, 10]),  # x = y = -0.1 m: floor
        ((4, 3), 1050, (-7.01, 5000.02, 0.0), [-71, 50000, 10]),
    ],
)
def test_a_pixel_falls_into_the_voxel_computed_by_hand(
    pixel: tuple[int, int], z: int, translation: tuple[float, float, float], expected: list[int]
) -> None:
    found = voxels(one_pixel(*pixel, z), Pose(LEVEL, translation), Rig(CAMERA, CAMERA), registered=True)
    assert [index for index, _ in found] == [expected]


def test_a_turned_camera_looks_along_its_own_axis() -> None:
    half = 0.5**0.5  # 90 degrees about y: forward is +x
    found = voxels(
        one_pixel(4, 3, 1050), Pose((0.0, half, 0.0, half), (0.0, 0.0, 0.05)), Rig(CAMERA, CAMERA), registered=True
    )
    assert found[0][0] == [10, 0, 0]


@given(z=st.integers(1, 60000))
def test_identity_between_equal_cameras_returns_the_pixel_itself(z: int) -> None:
    depth = np.full((CAMERA.height, CAMERA.width), z, np.uint16)
    rig = Rig(CAMERA, CAMERA)
    assert voxels(depth, Pose.identity(), rig, registered=False) == voxels(depth, Pose.identity(), rig, registered=True)


def test_a_colour_camera_beside_the_depth_camera_sees_near_things_further_to_the_side() -> None:
    # 0.2 m to the right: at 1 m, focal length 10, a point straight ahead is 2 pixels further left
    rig = Rig(CAMERA, CAMERA, Pose(LEVEL, (0.2, 0.0, 0.0)))
    ((_, label),) = voxels(one_pixel(4, 3, 1000), Pose.identity(), rig, registered=False)
    assert label == 3 * CAMERA.width + 2


def test_what_the_colour_camera_cannot_see_is_left_out() -> None:
    rig = Rig(CAMERA, CAMERA, Pose(LEVEL, (0.0, 0.0, 2.0)))  # the colour camera stands in front of the point
    assert voxels(one_pixel(4, 3, 1000), Pose.identity(), rig, registered=False) == []
    far_aside = Rig(CAMERA, CAMERA, Pose(LEVEL, (5.0, 0.0, 0.0)))
    assert voxels(one_pixel(4, 3, 1000), Pose.identity(), far_aside, registered=False) == []


def test_colour_pixels_are_rounded_to_the_nearest() -> None:
    eye, none = np.eye(3, dtype=np.int64) << 26, np.zeros(3, np.int64)
    camera = np.array([10 << 16, 10 << 16, 4 << 16, 3 << 16], np.int64)
    slope = 1 << 18
    assert color_pixel(1000, slope * 14 // 100, 0, eye, none, camera, 8, 6) == (5, 3)  # 4 + 1.4
    assert color_pixel(1000, slope * 16 // 100, 0, eye, none, camera, 8, 6) == (6, 3)  # 4 + 1.6


@given(st.lists(st.tuples(*[st.integers(-(1 << 20), (1 << 20) - 1)] * 3), min_size=1, max_size=20))
def test_keys_hold_indices_and_keep_their_order(indices: list[tuple[int, int, int]]) -> None:
    keys = voxel_key(np.array(indices, np.int64))
    assert voxel_index(keys).tolist() == [list(index) for index in indices]
    assert voxel_index(np.sort(keys)).tolist() == [list(index) for index in sorted(indices)]


def test_a_camera_out_of_range_asks_for_an_origin() -> None:
    rays = projection.pixel_rays(CAMERA)
    projection.voxel_transform(Pose(LEVEL, (41_000.0, -41_000.0, 0.0)), 0.04, rays, 6000)
    with pytest.raises(InputError, match=r"\(43000, 0, 0\) m is beyond the map's range of 42 km; .*--origin X,Y,Z"):
        projection.voxel_transform(Pose(LEVEL, (43_000.0, 0.0, 0.0)), 0.04, rays, 6000)


def test_rays_that_would_overflow_are_refused() -> None:
    wide = projection.pixel_rays(Intrinsics(1000, 1000, 1.0, 1.0, 500.0, 500.0))
    with pytest.raises(InputError, match="a voxel of 2 mm is too small for this camera's field of view"):
        projection.voxel_transform(Pose.identity(), 0.002, wide, 6000)
