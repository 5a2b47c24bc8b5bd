"""replay: what it writes, and what it says of bad input."""

from __future__ import annotations

import gc
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import tiny_frames

from openvox.apps.loop import run
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.core.digest import map_digest
from openvox.core.errors import InputError, OutputError
from openvox.core.mapper_parameters import PRESETS
from openvox.core.types import InstanceMap, Step
from openvox.formats.map_npz import read_map
from openvox.formats.perception import read_masks
from openvox.formats.recording import RecordingWriter, read_frames
from openvox.formats.trace import read_trace, trace_info, votes_after
from openvox.mapper.mapper import Mapper


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Four frames of a tiny world with its truth as masks."""
    path = tmp_path / "tiny.mcap"
    with RecordingWriter(path, source="test", categories={1: "box", 2: "ball"}) as writer:
        for frame in tiny_frames(4):
            writer.add(frame)
    perceive(path, frontend="oracle", assignments=["oracle.min_pixels=1"])
    return path


def replayed(recording: Path, **options: Any) -> dict[str, Any]:
    return replay(recording, assignments=["masks.min_pixels=0", *options.pop("sets", [])], **options)


def test_map_and_trace_lie_beside_the_recording_and_say_what_made_them(recording: Path) -> None:
    result = replayed(recording)
    made = read_map(Path(result["outputs"]["map"]))
    assert result["outputs"]["map"] == str(recording.with_name("tiny.map.npz"))
    assert result["outputs"]["trace"] == str(recording.with_name("tiny.trace.mcap"))
    assert made.meta["recording"] == "tiny.mcap"
    assert made.meta["digests"]["map"] == map_digest(made) == result["digests"]["map"]
    assert trace_info(recording.with_name("tiny.trace.mcap")).digest == result["digests"]["trace"]


def test_the_loop_is_all_there_is(recording: Path) -> None:
    masks = {found.index: found.masks for found in read_masks(recording.with_name("tiny.perception.mcap"))}
    mapper = Mapper(PRESETS["paper"])
    run(((frame, masks[frame.index]) for frame in read_frames(recording)), mapper)
    assert map_digest(mapper.finish()) == replayed(recording, preset_name="paper")["digests"]["map"]


def test_old_objects_are_left_alone_while_frames_come_and_looked_at_again_after(recording: Path) -> None:
    frozen = []

    class Watching:
        def on_step(self, step: Step) -> None:
            frozen.append(gc.get_freeze_count() > 0)
            raise KeyboardInterrupt

        def close(self, result: InstanceMap) -> None:
            raise AssertionError

    with pytest.raises(KeyboardInterrupt):
        run(((frame, ()) for frame in read_frames(recording)), Mapper(PRESETS["paper"]), [Watching()])
    assert frozen == [True]
    assert gc.get_freeze_count() == 0


@pytest.mark.parametrize("preset", ["openvox", "paper"])
def test_the_trace_rebuilds_the_votes_without_mapping(recording: Path, preset: str) -> None:
    made = read_map(Path(replayed(recording, preset_name=preset)["outputs"]["map"]))
    index, counts = votes_after(recording.with_name("tiny.trace.mcap"), frame=3)
    rows = {tuple(voxel): row for row, voxel in enumerate(made.voxel_index.tolist())}
    expected = {
        (row, int(made.vote_fragment[vote])): int(made.vote_count[vote])
        for row in range(len(made.voxel_index))
        for vote in range(made.vote_offset[row], made.vote_offset[row + 1])
    }
    assert {(rows[tuple(index[voxel].tolist())], f): count for (voxel, f), count in counts.items()} == expected


def test_the_trace_holds_every_decision_with_its_scores(recording: Path) -> None:
    result = replayed(recording)
    frames = list(read_trace(recording.with_name("tiny.trace.mcap")))
    assert [frame.frame for frame in frames] == [0, 1, 2, 3]
    rules = [decision["by"] for frame in frames for decision in frame.decisions]
    assert {rule: rules.count(rule) for rule in set(rules)} == result["decisions"]
    assert all(decision["threshold"] == 419430 for frame in frames for decision in frame.decisions)
    assert any(event.kind == "new" for event in frames[0].events)


def test_a_range_of_frames_maps_those_alone(recording: Path) -> None:
    assert replayed(recording, start=1, end=4, stride=2)["frames"] == 2


def test_frames_that_perception_did_not_look_at_change_nothing(recording: Path) -> None:
    few = recording.with_name("few.perception.mcap")
    perceive(recording, frontend="oracle", out=few, start=0, end=2, assignments=["oracle.min_pixels=1"])
    all_frames = replayed(recording, perception=few)
    assert all_frames["digests"]["map"] == replayed(recording, perception=few, end=2)["digests"]["map"]
    assert (all_frames["frames"], all_frames["looked"]) == (4, 2)


def test_precedence_is_preset_then_file_then_set(recording: Path) -> None:
    toml = recording.with_name("p.toml")
    toml.write_text("[map]\nvoxel_size = 0.1\nmax_depth = 5.0\n")
    parameters = replayed(recording, params=toml, sets=["map.voxel_size=0.2"])["parameters"]
    assert (parameters["map.voxel_size"], parameters["map.max_depth"]) == (0.2, 5.0)


def test_missing_perception_says_what_to_run(recording: Path) -> None:
    recording.with_name("tiny.perception.mcap").unlink()
    with pytest.raises(InputError, match=r"tiny\.perception\.mcap: no such file; run openvox perceive"):
        replayed(recording)


def test_masks_of_other_pixels_are_refused_and_leave_the_old_map(recording: Path) -> None:
    replayed(recording)
    before = recording.with_name("tiny.map.npz").read_bytes()
    other = recording.with_name("other.mcap")
    with RecordingWriter(other, source="test") as writer:
        for frame in tiny_frames(4, color_format="png"):
            writer.add(frame)
    with pytest.raises(InputError, match="frame 0: its masks were made from other pixels"):
        replayed(other, perception=recording.with_name("tiny.perception.mcap"), out=str(recording.with_name("tiny")))
    assert recording.with_name("tiny.map.npz").read_bytes() == before
    assert not list(recording.parent.glob("*.partial"))


@pytest.mark.parametrize("suffix", ["", ".map.npz", ".trace.mcap"])
def test_a_map_named_as_what_to_write_gives_its_stem(recording: Path, suffix: str) -> None:
    outputs = replayed(recording, out=str(recording.with_name(f"other{suffix}")))["outputs"]
    assert outputs["map"] == str(recording.with_name("other.map.npz"))
    assert outputs["trace"] == str(recording.with_name("other.trace.mcap"))


def test_an_output_that_cannot_be_written_is_one_sentence(recording: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere/run\.trace\.mcap could not be written"):
        replayed(recording, out=str(recording.parent / "nowhere" / "run"))


def test_an_output_never_overwrites_what_it_is_made_from(recording: Path) -> None:
    taken = recording.with_name("run.trace.mcap")
    taken.write_bytes(recording.with_name("tiny.perception.mcap").read_bytes())
    with pytest.raises(InputError, match="would be overwritten by what is made from it"):
        replayed(recording, perception=taken, out=str(recording.with_name("run")))


def test_a_full_disk_ends_in_one_sentence_and_leaves_nothing(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from openvox.formats import trace

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(trace.McapWriter, "add", full)
    with pytest.raises(OutputError, match="No space left on device"):
        replayed(recording)
    assert not list(recording.parent.glob("*.partial"))
    assert not recording.with_name("tiny.map.npz").exists()


def test_no_frame_in_the_range_is_said(recording: Path) -> None:
    with pytest.raises(InputError, match="no frame lies in the chosen range"):
        replayed(recording, start=50)


def test_a_camera_at_utm_coordinates_asks_for_an_origin(tmp_path: Path) -> None:
    from dataclasses import replace

    from openvox.core.types import Pose

    path = tmp_path / "far.mcap"
    far = Pose((0.0, 0.0, 0.0, 1.0), (450_000.0, 5_400_000.0, 0.0))
    with RecordingWriter(path, source="test", categories={1: "box"}) as writer:
        for frame in tiny_frames(1):
            writer.add(replace(frame, world_from_depth=far))
    perceive(path, frontend="oracle")
    with pytest.raises(InputError, match=r"beyond the map's range of 42 km; ingest again with --origin"):
        replay(path)


def test_explain_gives_the_scores_of_the_trace(recording: Path) -> None:
    from openvox.apps.explain import explain_frame

    replayed(recording)
    found = explain_frame(recording.with_name("tiny.trace.mcap"), 1)
    assert found["frame"] == 1
    assert found["decisions"][0]["threshold"] == pytest.approx(0.4, abs=1e-6)
    assert json.dumps(found)
    with pytest.raises(InputError, match="frame 9 was not mapped; it holds 4 frames"):
        explain_frame(recording.with_name("tiny.trace.mcap"), 9)


def test_results_are_plain_numbers(recording: Path) -> None:
    result = replayed(recording)
    assert json.loads(json.dumps(result)) == result
    assert set(result["ms"]) == {"decode", "masks", "project", "associate", "evolve", "trace"}
    assert np.isfinite(result["frames_per_second"])


def test_what_finishing_drops_is_an_event_with_its_reason(recording: Path) -> None:
    replayed(recording, sets=["finish.min_voxels=100000"])
    last = list(read_trace(recording.with_name("tiny.trace.mcap")))[-1]
    dropped = [event for event in last.events if event.kind == "dropped"]
    assert dropped
    assert {event.frame for event in dropped} == {3}
    assert "voxels: too few" in dropped[0].text


def test_masks_for_none_of_the_frames_are_refused_and_leave_the_old_map(recording: Path) -> None:
    replayed(recording)
    before = recording.with_name("tiny.map.npz").read_bytes()
    late = recording.with_name("late.perception.mcap")
    perceive(recording, frontend="oracle", out=late, start=3, assignments=["oracle.min_pixels=1"])
    with pytest.raises(InputError, match=r"late\.perception\.mcap: it has masks for none of the chosen frames"):
        replayed(recording, perception=late, end=2)
    assert recording.with_name("tiny.map.npz").read_bytes() == before


def test_file_and_set_are_one_choice(recording: Path) -> None:
    toml = recording.with_name("p.toml")
    toml.write_text("[lifecycle]\nevidence = false\n")
    chosen = replayed(recording, params=toml, sets=["lifecycle.evidence=true"])["parameters"]
    assert chosen["evolution.cut"]
    assert chosen["lifecycle.captions"]


def test_what_was_replaced_is_said(recording: Path) -> None:
    assert replayed(recording)["replaced"] == []
    result = replayed(recording)
    assert result["replaced"] == [result["outputs"][name] for name in ("map", "trace", "times")]


def test_a_map_never_stands_beside_a_trace_that_could_not_be_completed(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mcap.writer import Writer

    def full(self: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Writer, "finish", full)
    with pytest.raises(OutputError, match="No space left on device"):
        replayed(recording)
    assert not recording.with_name("tiny.map.npz").exists()
    assert not list(recording.parent.glob("*.partial"))
