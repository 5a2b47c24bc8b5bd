"""Several passes over the same frames: each has the map before it as the prior, and frames count once."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import naive
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from strategies import World, rectangle, small, wall, worlds
from test_engines import assert_equal_maps
from typer.testing import CliRunner
from worlds import tiny_frames

from openvox.apps.compare import compare
from openvox.apps.explain import explain
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.cli.commands import app
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import OPENVOX
from openvox.core.types import Mask
from openvox.formats.map_npz import read_map
from openvox.formats.recording import RecordingWriter
from openvox.formats.trace import read_trace, trace_info, votes_after
from openvox.mapper.mapper import Mapper

NO_TORCH = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch; tools/test --torch")
LEFT, RIGHT, BOTH = rectangle(0, 0, 6, 10), rectangle(6, 0, 12, 10), rectangle(0, 0, 12, 10)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(world=worlds())
@pytest.mark.parametrize("engine", ["cpu", pytest.param("torch", marks=NO_TORCH)])
def test_a_second_pass_is_that_of_the_slow_twin(engine: str, world: World) -> None:
    mapper, twin = Mapper(world.parameters, engine=engine), naive.Twin(world.parameters)
    for again in (False, True):
        if again:
            mapper.look_again()
            twin.look_again()
        for frame, masks in world.frames:
            assert mapper.step(frame, masks).decisions == twin.step(frame, masks)
    assert_equal_maps(mapper.finish(), twin.finish())


def mapped(*frames: tuple[Mask, ...], passes: int = 1) -> tuple[Mapper, list[tuple[Any, ...]]]:
    """A wall seen with these masks, and the decisions of the last pass."""
    mapper = Mapper(small(OPENVOX, erosion=0, step_margin=0))
    for number in range(passes):
        if number:
            mapper.look_again()
        decisions = [mapper.step(wall(i), masks).decisions for i, masks in enumerate(frames)]
    return mapper, decisions


def test_the_first_frame_is_seen_with_what_later_ones_taught() -> None:
    frames = ((BOTH,), *[(LEFT, RIGHT)] * 4)
    _, causal = mapped(*frames)
    _, hindsight = mapped(*frames, passes=2)
    assert causal[0][0].by == "new"
    assert hindsight[0][0].by == "containment"
    assert hindsight[0][0].held == (1, 2)


def test_votes_add_up_but_frames_count_once() -> None:
    once, twice = (mapped(*[(LEFT, RIGHT)] * 4, passes=n)[0].finish() for n in (1, 2))
    assert twice.vote_count.tolist() == [2 * count for count in once.vote_count.tolist()]
    np.testing.assert_array_equal(twice.voxel_confidence, once.voxel_confidence)
    for a, b in zip(once.instances, twice.instances, strict=True):
        assert (a.observations, a.first_frame, a.last_frame, a.confirmed_frame) == (4, 0, 3, b.confirmed_frame)
        assert (b.observations, b.first_frame, b.last_frame) == (4, 0, 3)


def test_what_no_frame_of_the_last_pass_matched_is_gone() -> None:
    mapper = mapped((LEFT, RIGHT), (LEFT, RIGHT))[0]
    mapper.look_again()
    for i in range(2):
        mapper.step(wall(i), (LEFT,))
    assert mapper.finish().instance_id.tolist() == [1]


# ---- replay --passes ------------------------------------------------------------------------------------------------


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.mcap"
    with RecordingWriter(path, source="test", categories={1: "box", 2: "ball"}) as writer:
        for frame in tiny_frames(4):
            writer.add(frame)
    perceive(path, frontend="oracle", assignments=["oracle.min_pixels=1"])
    return path


def replayed(recording: Path, name: str, **options: Any) -> dict[str, Any]:
    return replay(recording, out=str(recording.with_name(name)), assignments=["masks.min_pixels=0"], **options)


@pytest.mark.parametrize("preset", ["openvox", "official", "paper"])
def test_the_causal_result_stands_beside_that_of_the_last_pass(recording: Path, preset: str) -> None:
    once = replayed(recording, "once", preset_name=preset)
    twice = replayed(recording, "twice", preset_name=preset, passes=2)
    first, last = twice["passes"]
    assert once["passes"] == [first]
    assert first["digests"] == {name: once["digests"][name] for name in ("map", "trace")}
    assert last["digests"] == {name: twice["digests"][name] for name in ("map", "trace")}
    assert last["digests"]["map"] != first["digests"]["map"]
    assert twice["frames"] == once["frames"] == 4
    assert replayed(recording, "again", preset_name=preset, passes=2)["digests"] == twice["digests"]
    assert read_map(Path(twice["outputs"]["map"])).meta["passes_before"] == [first]


def test_the_trace_is_of_the_last_pass_and_rebuilds_its_votes(recording: Path) -> None:
    result = replayed(recording, "twice", passes=2)
    trace, made = Path(result["outputs"]["trace"]), read_map(Path(result["outputs"]["map"]))
    assert [found.frame for found in read_trace(trace)] == [0, 1, 2, 3]
    assert trace_info(trace).digest == result["digests"]["trace"]
    assert trace_info(trace).run["passes_before"] == result["passes"][:1]
    index, counts = votes_after(trace, 3)
    assert {tuple(index[voxel].tolist()) for voxel, _ in counts} == {tuple(row) for row in made.voxel_index.tolist()}
    assert sum(counts.values()) == made.vote_count.sum()
    assert explain(trace, frame=0, mask=0)


def test_a_map_of_two_passes_can_be_watched_and_resumed(recording: Path) -> None:
    half = replayed(recording, "half", passes=2, end=2, rerun=recording.with_name("half.rrd"))
    rest = replayed(recording, "rest", resume=Path(half["outputs"]["map"]), rerun=recording.with_name("rest.rrd"))
    assert all(recording.with_name(name).exists() for name in ("half.rrd", "rest.rrd"))
    assert rest["frames"] == 2
    assert len(rest["passes"]) == 1


def test_compare_says_how_often_frames_were_mapped_where_that_differs(recording: Path) -> None:
    once, twice = (Path(replayed(recording, f"p{n}", passes=n)["outputs"]["map"]) for n in (1, 2))
    found = compare(once, twice)
    assert (found["a"]["passes"], found["b"]["passes"]) == (1, 2)
    assert found["notes"] == ["the frames were mapped once in A, 2 times in B (replay --passes)"]
    assert compare(once, once)["notes"] == []


@pytest.mark.parametrize(
    ("passes", "resume", "sentence"), [(0, False, "--passes is 0"), (2, True, "leave out one of the two")]
)
def test_passes_that_make_no_sense_are_one_sentence(recording: Path, passes: int, resume: bool, sentence: str) -> None:
    earlier = Path(replayed(recording, "half", end=2)["outputs"]["map"]) if resume else None
    with pytest.raises(InputError, match=sentence):
        replayed(recording, "rest", passes=passes, resume=earlier)
    assert not list(recording.parent.glob("rest*"))


def test_the_command_says_what_each_pass_gave(recording: Path) -> None:
    said = CliRunner().invoke(app, ["replay", str(recording), "--passes", "2"])
    assert said.exit_code == 0, said.output
    assert "after pass 1:" in said.output
