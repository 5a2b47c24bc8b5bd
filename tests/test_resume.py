"""A map keeps what a run needs to go on: resumed at any frame, it is the run that never stopped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from worlds import tiny_frames, truth_masks

from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import PRESETS
from openvox.core.types import Frame, Mask
from openvox.formats.map_npz import read_map, write_map
from openvox.mapper.mapper import Mapper


def masks(frame: Frame) -> tuple[Mask, ...]:
    """The truth, each with an embedding of its own."""
    rows = np.eye(8, dtype=np.float32)
    return tuple(replace(mask, embedding=rows[i % 8]) for i, mask in enumerate(truth_masks(frame)))


@pytest.mark.parametrize("preset", ["openvox", "paper"])
@pytest.mark.parametrize("stop", [1, 2, 4])
def test_a_resumed_run_is_the_run_that_never_stopped(tmp_path: Path, preset: str, stop: int) -> None:
    chosen = replace(PRESETS[preset], masks=replace(PRESETS[preset].masks, min_pixels=0, erosion=0, step_margin=0))
    whole = Mapper(chosen)
    frames = tiny_frames(5)
    for frame in frames[:stop]:
        whole.step(frame, masks(frame))
    write_map(tmp_path / "half.npz", whole.finish())
    resumed = Mapper.resumed(read_map(tmp_path / "half.npz"), chosen)
    assert map_digest(resumed.finish()) == map_digest(whole.finish())
    for frame in frames[stop:]:
        expected, actual = whole.step(frame, masks(frame)), resumed.step(frame, masks(frame))
        assert actual.decisions == expected.decisions
        assert actual.events == expected.events
        assert actual.changes.first_new == expected.changes.first_new
        assert actual.changes.voxel.tolist() == expected.changes.voxel.tolist()
        assert actual.changes.count.tolist() == expected.changes.count.tolist()
    assert map_digest(resumed.finish()) == map_digest(whole.finish())


def test_a_map_without_state_is_refused(tmp_path: Path) -> None:
    whole = Mapper(PRESETS["paper"])
    frame = tiny_frames(1)[0]
    whole.step(frame, masks(frame))
    with pytest.raises(InputError, match="holds no state to resume from"):
        Mapper.resumed(replace(whole.finish(), state={}), PRESETS["paper"])


def test_state_of_another_version_is_refused() -> None:
    whole = Mapper(PRESETS["paper"]).finish()
    state = {**whole.state, "counters": np.array([99, 0, 0, -1])}
    with pytest.raises(InputError, match="state has version 99"):
        Mapper.resumed(replace(whole, state=state), PRESETS["paper"])
