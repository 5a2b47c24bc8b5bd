"""The engine is the slow twin, but fast: equal decisions and equal maps, bit for bit."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import naive
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from strategies import World, worlds

from openvox.apps.ingest import ingest
from openvox.apps.perceive import perceive
from openvox.core.digest import map_digest
from openvox.core.mapper_parameters import OPENVOX, PAPER, MapperParameters
from openvox.core.types import Frame, InstanceMap, Intrinsics, Mask, Rig
from openvox.formats.perception import read_masks
from openvox.formats.recording import read_frames
from openvox.mapper.mapper import Mapper

ARRAYS = (
    "voxel_index", "vote_offset", "vote_fragment", "vote_count", "fragment_id", "fragment_instance", "voxel_instance",
    "voxel_confidence", "instance_id", "instance_confidence", "feature", "feature_weight",
)  # fmt: skip


def assert_equal_maps(actual: InstanceMap, expected: InstanceMap) -> None:
    for name in ARRAYS:
        a, b = getattr(actual, name), getattr(expected, name)
        assert a.dtype == b.dtype, name
        np.testing.assert_array_equal(a, b, err_msg=name)
    assert map_digest(actual) == map_digest(expected)


def assert_engine_is_naive(frames: Iterable[tuple[Frame, Sequence[Mask] | None]], parameters: MapperParameters) -> None:
    mapper, twin = Mapper(parameters), naive.Twin(parameters)
    for frame, masks in frames:
        expected = twin.step(frame, masks)
        assert mapper.step(frame, masks).decisions == expected
    assert_equal_maps(mapper.finish(), twin.finish())


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(world=worlds())
def test_the_engine_is_naive_but_fast(world: World) -> None:
    assert_engine_is_naive(world.frames, world.parameters)


RECORDINGS = Path(__file__).resolve().parents[1] / "recordings"


def smaller(camera: Intrinsics, step: int) -> Intrinsics:
    """The camera that sees every step-th pixel."""
    width, height = -(-camera.width // step), -(-camera.height // step)
    return Intrinsics(width, height, camera.fx / step, camera.fy / step, camera.cx / step, camera.cy / step)


def thinned(frame: Frame, masks: Sequence[Mask], step: int) -> tuple[Frame, tuple[Mask, ...]]:
    """Frame and masks with every step-th pixel: the twin is slow."""
    rig, color = frame.rig, frame.rig.color
    small = Rig(smaller(rig.depth, step), smaller(color, step), rig.depth_from_color)
    few = []
    for mask in masks:
        fields = {name: getattr(mask, name) for name in ("score", "caption", "named", "kind", "embedding")}
        few.append(Mask.from_bitmap(mask.bitmap(color.height, color.width)[::step, ::step], **fields))
    depth = np.ascontiguousarray(frame.depth[::step, ::step])
    return Frame(frame.index, frame.stamp_ns, frame.world_from_depth, small, depth), tuple(few)


def few_pixels(preset: MapperParameters) -> MapperParameters:
    """The preset with coarser voxels, since there are fewer pixels."""
    masks = replace(preset.masks, min_pixels=min(preset.masks.min_pixels, 4))
    return replace(preset, map=replace(preset.map, voxel_size=0.1), masks=masks)


@pytest.mark.parametrize("preset", [OPENVOX, PAPER], ids=["openvox", "paper"])
def test_the_engine_is_naive_on_the_bundled_recording(preset: MapperParameters) -> None:
    frames = read_frames(RECORDINGS / "living_demo.mcap", end=28, truth=False)
    masks = {found.index: found.masks for found in read_masks(RECORDINGS / "living_demo.perception.mcap", end=28)}
    assert_engine_is_naive((thinned(frame, masks[frame.index], 8) for frame in frames), few_pixels(preset))


@pytest.mark.parametrize("preset", [OPENVOX, PAPER], ids=["openvox", "paper"])
def test_the_engine_is_naive_with_two_real_cameras(preset: MapperParameters, shared_data: Path, tmp_path: Path) -> None:
    recording = tmp_path / "kitchen.mcap"
    ingest(shared_data / "real_kitchen", recording, end=8)
    perceive(recording, frontend="geometry")
    masks = {found.index: found.masks for found in read_masks(tmp_path / "kitchen.perception.mcap")}
    frames = list(read_frames(recording))
    assert not frames[0].rig.registered
    assert_engine_is_naive((thinned(frame, masks[frame.index], 8) for frame in frames), few_pixels(preset))
