"""--frontend oracle with faults: hard cases from truth, the same on every run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from worlds import CATEGORIES, tiny_frames

from openvox.core.types import Frame, Mask
from openvox.perception.oracle import OracleMasks
from openvox.perception.parameters import OracleParameters


def seen(frame: Frame, **faults: Any) -> tuple[Mask, ...]:
    return OracleMasks(OracleParameters(min_pixels=1, **faults), CATEGORIES)(frame, ())


def areas(masks: tuple[Mask, ...]) -> list[int]:
    return sorted(mask.area for mask in masks)


@pytest.fixture
def frame() -> Frame:
    """A floor, and things on it that touch it."""
    return tiny_frames(1)[0]


def test_without_faults_every_instance_is_one_whole_mask(frame: Frame) -> None:
    assert frame.truth_instances is not None
    truth = np.bincount(frame.truth_instances.reshape(-1))[1:]
    assert areas(seen(frame)) == sorted(truth[truth > 0].tolist())


def test_all_missed_is_nothing_seen(frame: Frame) -> None:
    assert seen(frame, miss=1.0) == ()


def test_split_masks_are_two_with_the_pixels_of_one(frame: Frame) -> None:
    whole, parts = seen(frame), seen(frame, split=1.0)
    assert len(parts) == 2 * len(whole)
    assert sum(areas(parts)) == sum(areas(whole))


def test_merged_masks_have_the_pixels_of_both(frame: Frame) -> None:
    whole, merged = seen(frame), seen(frame, merge=1.0)
    assert len(merged) < len(whole)
    assert sum(areas(merged)) == sum(areas(whole))


def test_boundaries_grow_and_shrink_by_no_more_than_was_asked(frame: Frame) -> None:
    assert areas(seen(frame, boundary=0.4)) == areas(seen(frame))
    changed = {tuple(areas(seen(frame, boundary=2.0, seed=seed))) for seed in range(4)}
    assert len(changed) > 1


def test_a_fault_lasts_an_episode_and_another_seed_gives_others() -> None:
    frames = tiny_frames(12)
    kept = [[mask.label for mask in seen(frame, miss=0.5, episode=6)] for frame in frames[6:8]]
    assert kept[0] == kept[1]
    counts = [[len(seen(frame, miss=0.5, episode=1, seed=seed)) for frame in frames] for seed in (0, 0, 1)]
    assert counts[0] == counts[1] != counts[2]


def test_a_digest_tells_frames_and_faults_apart(frame: Frame) -> None:
    digests = {
        OracleMasks(OracleParameters(min_pixels=1, **faults), CATEGORIES).digest(frame)
        for faults in ({}, {"miss": 0.5}, {"miss": 0.5, "seed": 1})
    }
    assert len(digests) == 3
