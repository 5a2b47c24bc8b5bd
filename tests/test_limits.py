"""Large pictures, many masks, many ids, numbers at their ends: exact, on every engine."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pytest
from strategies import rectangle, wall

from openvox.core.digest import map_digest
from openvox.core.mapper_parameters import OPENVOX, PAPER, PRESETS, MapperParameters
from openvox.core.parameters import as_dict, describe, updated
from openvox.core.types import Intrinsics, Mask, Pose, Rig
from openvox.mapper.mapper import Mapper

NO_TORCH = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch; tools/test --torch")
ENGINES = pytest.mark.parametrize("engine", ["cpu", pytest.param("torch", marks=NO_TORCH)])
LARGE = Intrinsics(1280, 720, 900.0, 900.0, 639.5, 359.5)
NEVER_JOINS = updated(PAPER, {"association.threshold": 1.0}, source="test")


@ENGINES
def test_a_voxel_under_a_thousand_masks_keeps_a_thousand_ids(engine: str) -> None:
    mapper = Mapper(NEVER_JOINS, engine=engine)
    mask = rectangle(2, 2, 9, 8)
    mapper.step(wall(0), (mask,) * 1000)  # a thousand combinations of masks, too
    step = mapper.step(wall(1), (mask,))
    result = mapper.finish()
    assert result.vote_fragment[:1001].tolist() == list(range(1, 1002))
    assert (result.vote_count == 1).all()
    assert [candidate.instance for candidate in step.decisions[0].candidates] == list(range(1, 1001))
    assert {candidate.s_geo for candidate in step.decisions[0].candidates} == {2**20 // 1000}


@ENGINES
def test_two_million_voxels_in_one_frame(engine: str) -> None:
    camera = Intrinsics(1920, 1080, 900.0, 900.0, 959.5, 539.5)
    fine = {"map.voxel_size": 0.002, "masks.erosion": 0, "masks.step_margin": 0}
    mapper = Mapper(updated(OPENVOX, fine, source="test"), engine=engine)
    step = mapper.step(wall(0, 4000, rig=Rig(camera, camera)), (rectangle(0, 0, 960, 1080, camera),))
    assert step.voxels == mapper.voxels == 1920 * 1080
    assert step.decisions[0].voxels == 960 * 1080
    fragments, counts = np.unique(np.stack([step.changes.fragment, step.changes.count]), axis=1, return_counts=True)
    assert fragments.tolist() == [[0, 1], [1, 2]]  # one half vote for background, two for the mask
    assert counts.tolist() == [960 * 1080, 960 * 1080]


def grid() -> tuple[Mask, ...]:
    """A hundred masks of 128 x 72 pixels."""
    cells = ((u, v) for u in range(0, 1280, 128) for v in range(0, 720, 72))
    return tuple(rectangle(u, v, u + 128, v + 72, LARGE) for u, v in cells)


def test_a_hundred_masks_a_frame_at_720p_and_four_thousand_fragments() -> None:
    mapper, masks, rig = Mapper(OPENVOX), grid(), Rig(LARGE, LARGE)
    for i in range(40):
        pose = Pose((0.0, 0.0, 0.0, 1.0), (10.0 * i, 0.0, 0.0))
        step = mapper.step(wall(i, 2000, pose, rig), masks)
        assert {decision.by for decision in step.decisions} == {"new"}
    assert mapper.fragments == 4000
    again = mapper.step(wall(40, 2000, Pose.identity(), rig), masks)
    assert [decision.fragment for decision in again.decisions] == list(range(1, 101))
    assert {decision.by for decision in again.decisions} == {"containment"}


@NO_TORCH
@pytest.mark.parametrize("preset", PRESETS.values(), ids=list(PRESETS))
def test_large_frames_give_the_same_on_both_engines(preset: MapperParameters) -> None:
    masks, rig = grid(), Rig(LARGE, LARGE)
    digests = set()
    for engine in ("cpu", "torch"):
        mapper = Mapper(preset, engine=engine)
        for i in range(2):
            mapper.step(wall(i, 2000, Pose((0.0, 0.0, 0.0, 1.0), (0.3 * i, 0.0, 0.0)), rig), masks)
        digests.add(map_digest(mapper.finish()))
    assert len(digests) == 1


@pytest.mark.parametrize("name", PRESETS)
def test_every_number_at_either_end_of_its_range_maps_or_says_why_not(name: str) -> None:
    values = as_dict(PRESETS[name])
    for row in describe(PRESETS[name]):
        used = (not row.needs or values[row.needs]) and not isinstance(row.default, (bool, str))
        for value in (row.low, row.high) if used else ():
            assert value is not None
            chosen = updated(PRESETS[name], {row.name: value}, source="test")
            mapper = Mapper(replace(chosen, masks=replace(chosen.masks, min_pixels=min(chosen.masks.min_pixels, 60))))
            for i in range(3):
                mapper.step(wall(i), (rectangle(0, 0, 12, 10), rectangle(0, 0, 6, 10)))
            result = mapper.finish()
            assert np.isfinite(result.instance_confidence).all(), row.name
            assert (result.vote_count > 0).all(), row.name


def test_a_detector_that_looks_at_every_tenth_frame_loses_no_object() -> None:
    masks = (rectangle(0, 0, 5, 10), rectangle(7, 0, 12, 10))
    coarse = updated(OPENVOX, {"masks.min_pixels": 0, "masks.erosion": 0, "map.voxel_size": 0.05}, source="test")
    every, tenth = Mapper(coarse), Mapper(coarse)
    for i in range(41):
        every.step(wall(i), masks)
        tenth.step(wall(i), masks if i % 10 == 0 else None)
    assert len(every.finish().instance_id) == len(tenth.finish().instance_id) == 2


def test_permuted_masks_of_unlike_areas_change_their_numbers_alone() -> None:
    masks = tuple(rectangle(u, 0, u + width, 10) for u, width in ((0, 3), (3, 4), (7, 5)))
    digests = set()
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        mapper = Mapper(updated(OPENVOX, {"masks.min_pixels": 0, "masks.erosion": 0}, source="test"))
        for i in range(3):
            mapper.step(wall(i), [masks[m] for m in order])
        digests.add(map_digest(mapper.finish()))
    assert len(digests) == 1
