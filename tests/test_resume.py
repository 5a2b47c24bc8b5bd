"""A map keeps what a run needs to go on: resumed at any frame, it is the run that never stopped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import tiny_frames, truth_masks

from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import PRESETS
from openvox.core.types import Frame, Mask
from openvox.formats.map_npz import read_map, write_map
from openvox.formats.recording import RecordingWriter
from openvox.formats.trace import read_trace, votes_after
from openvox.mapper.mapper import Mapper


def masks(frame: Frame) -> tuple[Mask, ...]:
    """The truth, each with an embedding of its own."""
    rows = np.eye(8, dtype=np.float32)
    return tuple(replace(mask, embedding=rows[i % 8]) for i, mask in enumerate(truth_masks(frame)))


@pytest.mark.parametrize("preset", ["openvox", "official", "paper"])
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
        if frame is frames[stop]:  # the whole map, for whoever watches from here on
            assert actual.changes.first_new == 0
            assert len(actual.changes.new_index) == len(actual.changes.touched) == actual.voxels == expected.voxels
            continue
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


# ---- replay --resume ------------------------------------------------------------------------------------------------


def recorded(path: Path, first: int = 0, frames: int = 6) -> Path:
    with RecordingWriter(path, source="test", categories={1: "box", 2: "ball"}) as writer:
        for frame in tiny_frames(frames, first=first):
            writer.add(frame)
    perceive(path, frontend="oracle", assignments=["oracle.min_pixels=1"])
    return path


def replayed(recording: Path, out: Path, **options: Any) -> dict[str, Any]:
    return replay(recording, out=str(out), assignments=["masks.min_pixels=0", *options.pop("sets", [])], **options)


@pytest.mark.parametrize("preset", ["openvox", "official", "paper"])
@pytest.mark.parametrize("stride", [1, 2])
def test_replay_resumed_at_any_frame_gives_the_digests_of_the_whole_run(
    tmp_path: Path, preset: str, stride: int
) -> None:
    recording = recorded(tmp_path / "a.mcap")
    whole = replayed(recording, tmp_path / "whole", preset_name=preset, stride=stride)
    stops = range(1, 5) if stride == 1 else (3,)
    for stop in stops:
        replayed(recording, tmp_path / "half", preset_name=preset, stride=stride, end=stop)
        half = tmp_path / "half.map.npz"
        rest = replayed(recording, tmp_path / "rest", preset_name=preset, stride=stride, resume=half)
        assert rest["digests"] == whole["digests"]
        assert rest["frames"] + read_map(half).meta["frames"] == whole["frames"]


def test_a_run_may_be_resumed_more_than_once(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "a.mcap")
    whole = replayed(recording, tmp_path / "whole")
    replayed(recording, tmp_path / "one", end=2)
    replayed(recording, tmp_path / "two", end=3, resume=tmp_path / "one.map.npz")
    assert replayed(recording, tmp_path / "three", resume=tmp_path / "two.map.npz")["digests"] == whole["digests"]
    meta = read_map(tmp_path / "three.map.npz").meta
    assert meta["frames"] == 6
    assert [run["frames"] for run in meta["resumed"]] == [2, 3]


def test_a_resumed_trace_rebuilds_the_votes_by_itself(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "a.mcap")
    replayed(recording, tmp_path / "whole")
    replayed(recording, tmp_path / "half", end=3)
    replayed(recording, tmp_path / "rest", resume=tmp_path / "half.map.npz")
    for frame in (3, 5):
        index, counts = votes_after(tmp_path / "rest.trace.mcap", frame)
        expected_index, expected = votes_after(tmp_path / "whole.trace.mcap", frame)
        assert index.tolist() == expected_index.tolist()
        assert counts == expected


def test_a_second_visit_goes_on_with_the_instances_of_the_first(tmp_path: Path) -> None:
    first, second = recorded(tmp_path / "a.mcap", frames=4), recorded(tmp_path / "b.mcap", first=2, frames=4)
    narrow = ["masks.step_margin=2"]  # the pictures are tiny: a wider margin would leave nothing
    before = replayed(first, tmp_path / "first", sets=list(narrow))
    after = replayed(second, tmp_path / "second", sets=list(narrow), resume=tmp_path / "first.map.npz")
    assert after["voxels"] > before["voxels"]
    known = read_map(tmp_path / "first.map.npz").instance_id.tolist()
    assert known
    assert set(known) <= set(read_map(tmp_path / "second.map.npz").instance_id.tolist())
    arrival = next(read_trace(tmp_path / "second.trace.mcap"))
    assert set(known) <= {decision["instance"] for decision in arrival.decisions if decision["by"] != "new"}
    assert read_map(tmp_path / "second.map.npz").meta["resumed"][0]["recording"] == "a.mcap"


def test_frames_that_the_map_has_already_are_not_mapped_twice(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "a.mcap")
    replayed(recording, tmp_path / "half", end=4)
    with pytest.raises(InputError, match=r"half\.map\.npz has this recording's frames up to 3 already"):
        replayed(recording, tmp_path / "rest", resume=tmp_path / "half.map.npz", start=2)
    said: list[str] = []
    replayed(recording, tmp_path / "rest", resume=tmp_path / "half.map.npz", start=5, notice=said.append)
    assert "frames 4 to 4 are left out: the map will not be that of a run without a break" in said
    with pytest.raises(InputError, match=r"rest\.map\.npz has mapped .*a\.mcap to its last frame, 5; there is nothing"):
        replayed(recording, tmp_path / "more", resume=tmp_path / "rest.map.npz")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"preset_name": "paper"}, "was mapped with preset openvox, this run has paper"),
        ({"sets": ["map.voxel_size=0.05"]}, "was mapped with map.voxel_size = 0.04, this run has 0.05"),
        ({"sets": ["finish.smoothing=1"]}, "was mapped with finish.smoothing = 3, this run has 1"),
    ],
)
def test_a_run_of_another_kind_is_one_sentence_and_leaves_nothing(
    tmp_path: Path, options: dict[str, Any], sentence: str
) -> None:
    recording = recorded(tmp_path / "a.mcap", frames=3)
    replayed(recording, tmp_path / "half", end=2)
    with pytest.raises(InputError, match=sentence):
        replayed(recording, tmp_path / "rest", resume=tmp_path / "half.map.npz", **options)
    assert not list(tmp_path.glob("rest*"))


def test_another_encoder_is_one_sentence(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "a.mcap", frames=3)
    replayed(recording, tmp_path / "half", end=2)
    half = read_map(tmp_path / "half.map.npz")
    write_map(tmp_path / "other.map.npz", replace(half, meta={**half.meta, "encoder": "clip"}))
    with pytest.raises(InputError, match=r"captions encoded by clip, .*a\.perception\.mcap has minilm"):
        replayed(recording, tmp_path / "rest", resume=tmp_path / "other.map.npz")


def test_a_map_of_a_version_without_a_parameter_is_one_sentence(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "a.mcap", frames=3)
    replayed(recording, tmp_path / "half", end=2)
    half = read_map(tmp_path / "half.map.npz")
    fewer = {name: value for name, value in half.meta["parameters"].items() if name != "evolution.near"}
    write_map(tmp_path / "old.map.npz", replace(half, meta={**half.meta, "parameters": fewer}))
    with pytest.raises(
        InputError, match=r"old\.map\.npz is of another version of openvox, without evolution\.near; replay"
    ):
        replayed(recording, tmp_path / "rest", resume=tmp_path / "old.map.npz")


def test_a_map_that_was_changed_or_lost_its_state_is_one_sentence(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "a.mcap", frames=3)
    replayed(recording, tmp_path / "half", end=2)
    half = read_map(tmp_path / "half.map.npz")
    write_map(tmp_path / "more.map.npz", replace(half, vote_count=half.vote_count + 1))
    with pytest.raises(InputError, match=r"more\.map\.npz is not as it was written"):
        replayed(recording, tmp_path / "rest", resume=tmp_path / "more.map.npz")
    write_map(tmp_path / "bare.map.npz", replace(half, state={}))
    with pytest.raises(InputError, match=r"bare\.map\.npz holds no state to resume from"):
        replayed(recording, tmp_path / "rest", resume=tmp_path / "bare.map.npz")


def test_state_that_does_not_fit_the_votes_is_one_sentence() -> None:
    mapper = Mapper(PRESETS["paper"])
    frame = tiny_frames(1)[0]
    mapper.step(frame, masks(frame))
    good = mapper.finish()
    for name, array in (("key", good.state["key"][1:]), ("fragment", good.state["fragment"][:0])):
        with pytest.raises(InputError, match="holds no state to resume from"):
            Mapper.resumed(replace(good, state={**good.state, name: array}), PRESETS["paper"])


def test_the_map_that_is_resumed_is_not_overwritten(tmp_path: Path) -> None:
    recording = recorded(tmp_path / "a.mcap", frames=3)
    replayed(recording, tmp_path / "half", end=2)
    with pytest.raises(InputError, match="would be overwritten by what is made from it"):
        replayed(recording, tmp_path / "half", resume=tmp_path / "half.map.npz")
