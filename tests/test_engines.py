"""Every engine is the slow twin, but fast: equal decisions and equal maps, bit for bit."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from pathlib import Path

import naive
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from strategies import World, worlds

from openvox.apps.ingest import ingest
from openvox.apps.perceive import perceive
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import OPENVOX, PRESETS, MapperParameters
from openvox.core.types import Frame, InstanceMap, Intrinsics, Mask, Rig, VoxelChanges
from openvox.formats.perception import read_masks
from openvox.formats.recording import read_frames
from openvox.mapper.mapper import Mapper

NO_TORCH = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch; tools/test --torch")
ENGINES = ["cpu", pytest.param("torch", marks=NO_TORCH)]
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


def assert_engine_is_naive(
    frames: Iterable[tuple[Frame, Sequence[Mask] | None]], parameters: MapperParameters, engine: str = "cpu"
) -> None:
    mapper, twin = Mapper(parameters, engine=engine), naive.Twin(parameters)
    for frame, masks in frames:
        expected = twin.step(frame, masks)
        assert mapper.step(frame, masks).decisions == expected
    result = mapper.finish()
    assert_equal_maps(result, twin.finish())
    for name, counts in (("together", twin.together), ("apart", twin.apart)):
        found = {(f, g): n for f, g, n in result.state[name].tolist() if n}
        assert found == {both: n for both, n in counts.items() if n}, name


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(world=worlds())
@pytest.mark.parametrize("engine", ENGINES)
def test_the_engine_is_naive_but_fast(engine: str, world: World) -> None:
    assert_engine_is_naive(world.frames, world.parameters, engine)


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


@pytest.mark.parametrize("preset", PRESETS.values(), ids=list(PRESETS))
@pytest.mark.parametrize("engine", ENGINES)
def test_the_engine_is_naive_on_the_bundled_recording(preset: MapperParameters, engine: str) -> None:
    frames = read_frames(RECORDINGS / "living_demo.mcap", end=28, truth=False)
    masks = {found.index: found.masks for found in read_masks(RECORDINGS / "living_demo.perception.mcap", end=28)}
    thin = (thinned(frame, masks[frame.index], 8) for frame in frames)
    assert_engine_is_naive(thin, few_pixels(preset), engine)


@pytest.mark.parametrize("preset", PRESETS.values(), ids=list(PRESETS))
@pytest.mark.parametrize("engine", ENGINES)
def test_the_engine_is_naive_with_two_real_cameras(
    preset: MapperParameters, engine: str, shared_data: Path, tmp_path: Path
) -> None:
    recording = tmp_path / "kitchen.mcap"
    ingest(shared_data / "real_kitchen", recording, end=8)
    perceive(recording, frontend="geometry")
    masks = {found.index: found.masks for found in read_masks(tmp_path / "kitchen.perception.mcap")}
    frames = list(read_frames(recording))
    assert not frames[0].rig.registered
    thin = (thinned(frame, masks[frame.index], 8) for frame in frames)
    assert_engine_is_naive(thin, few_pixels(preset), engine)


@NO_TORCH
def test_engines_tell_observers_the_same(shared_world: list[tuple[Frame, tuple[Mask, ...]]]) -> None:
    cpu, torch = (Mapper(OPENVOX, engine=engine) for engine in ("cpu", "torch"))
    for frame, masks in shared_world:
        a, b = cpu.step(frame, masks), torch.step(frame, masks)
        assert a.decisions == b.decisions
        assert a.events == b.events
        for field in fields(VoxelChanges):
            np.testing.assert_array_equal(getattr(a.changes, field.name), getattr(b.changes, field.name))


@NO_TORCH
@pytest.mark.parametrize(("first", "second"), [("cpu", "torch"), ("torch", "cpu")])
def test_a_run_may_be_resumed_on_another_engine(
    first: str, second: str, shared_world: list[tuple[Frame, tuple[Mask, ...]]]
) -> None:
    whole = Mapper(OPENVOX, engine=first)
    for frame, masks in shared_world[:6]:
        whole.step(frame, masks)
    resumed = Mapper.resumed(whole.finish(), OPENVOX, engine=second)
    for frame, masks in shared_world[6:]:
        assert whole.step(frame, masks).decisions == resumed.step(frame, masks).decisions
    assert_equal_maps(resumed.finish(), whole.finish())


@pytest.fixture(scope="module")
def shared_world() -> list[tuple[Frame, tuple[Mask, ...]]]:
    """Twelve frames of the bundled recording, every second pixel."""
    masks = {found.index: found.masks for found in read_masks(RECORDINGS / "living_demo.perception.mcap", end=24)}
    frames = read_frames(RECORDINGS / "living_demo.mcap", end=24, truth=False)
    return [thinned(frame, masks[frame.index], 2) for frame in frames]


def test_without_torch_its_engine_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "openvox.mapper.engines.torch_kernels", raising=False)
    with pytest.raises(InputError, match=r'engine torch needs torch, .* pip install "openvox\[torch\]"'):
        Mapper(OPENVOX, engine="torch")
