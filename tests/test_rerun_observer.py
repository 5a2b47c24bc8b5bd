"""What a run leaves for Rerun: read back, it says what the steps said."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader
from worlds import tiny_frames

from openvox.core.errors import OutputError
from openvox.core.mapper_parameters import OPENVOX
from openvox.core.types import Frame, InstanceMap, Mask, Step
from openvox.mapper.mapper import Mapper
from openvox.view.rerun_observer import RerunObserver

PARAMETERS = replace(OPENVOX, masks=replace(OPENVOX.masks, min_pixels=0, erosion=0, step_margin=0))
SIZE = PARAMETERS.map.voxel_size


def masks_of(frame: Frame) -> tuple[Mask, ...]:
    """The truth as masks."""
    truth = frame.truth_instances
    assert truth is not None
    ids = [i for i in np.unique(truth).tolist() if i]
    return tuple(Mask.from_bitmap(truth == i, caption=f"thing *{i}*") for i in ids)


def watched(path: Path, frames: list[Frame], **options: Any) -> tuple[list[Step], InstanceMap]:
    """Steps and map of a run over the truth, watched into a file for Rerun."""
    mapper, steps = Mapper(PARAMETERS), []
    with RerunObserver(path, voxel_size=SIZE, **options) as observer:
        for frame in frames:
            steps.append(mapper.step(frame, masks_of(frame)))
            observer.on_step(steps[-1])
        result = mapper.finish()
        observer.close(result)
    return steps, result


def rows(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Entity to its rows in the order of the file, without what has no value there."""
    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if name not in ("rerun.controls.RowId", "sensor_time")]
        columns = {name: batch.column(name).to_pylist() for name in names}
        for i in range(batch.num_rows):
            row = {name: column[i] for name, column in columns.items() if column[i] is not None}
            found.setdefault(str(chunk.entity_path), []).append(row)
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Step], InstanceMap]:
    """Four frames of the tiny world."""
    path = tmp_path_factory.mktemp("rerun") / "run.rrd"
    return (path, *watched(path, tiny_frames(4)))


Run = tuple[Path, list[Step], InstanceMap]


def test_every_frame_is_on_the_timeline_frame(run: Run) -> None:
    path, steps, _ = run
    assert [row["frame"] for row in rows(path)["/decisions/data"]] == [step.frame.index for step in steps]


def test_decisions_are_data_and_equal_those_of_the_steps(run: Run) -> None:
    path, steps, _ = run
    for row, step in zip(rows(path)["/decisions/data"], steps, strict=True):
        assert row["instance"] == [decision.instance for decision in step.decisions]
        assert row["by"] == [decision.by for decision in step.decisions]
        assert row["a"] == [decision.a / 2**20 for decision in step.decisions]
        assert row["caption"] == [step.masks[decision.mask].caption for decision in step.decisions]


def test_the_table_shows_rule_scores_and_threshold_of_every_mask(run: Run) -> None:
    path, steps, _ = run
    for row, step in zip(rows(path)["/decisions/table"], steps, strict=True):
        (text,) = row["TextDocument:text"]
        lines = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| #")]
        assert len(lines) == len(step.decisions)
        for line, decision in zip(lines, step.decisions, strict=True):
            assert f"| {decision.by} |" in line
            assert "/ 0.40" in line
            assert r"thing \*" in line


def test_colour_is_the_source_s_own_bytes_on_the_frustum(run: Run) -> None:
    path, steps, _ = run
    colors = [row for row in rows(path)["/camera/detected/color"] if "EncodedImage:blob" in row]
    assert [bytes(row["EncodedImage:blob"][0]) for row in colors] == [step.frame.color for step in steps]
    assert any("Pinhole:image_from_camera" in row for row in rows(path)["/world/camera"])


def test_changed_voxels_are_data_that_add_up_to_the_map(run: Run) -> None:
    path, steps, _ = run
    index: list[list[int]] = []
    owner: dict[int, int] = {}
    for row, step in zip(rows(path)["/world/voxel_states"], steps, strict=True):
        owner.update(zip(step.changes.touched.tolist(), step.changes.owner.tolist(), strict=True))
        index += map(list, zip(row["new_x"], row["new_y"], row["new_z"], strict=True))
        assert len(index) == step.voxels
        assert row["instance"] == [step.instance_of.get(owner[voxel], 0) for voxel in row["voxel"]]
    assert index == np.concatenate([step.changes.new_index for step in steps]).tolist()


def test_the_last_state_is_the_finished_map(run: Run) -> None:
    path, _, result = run
    entities = rows(path)
    for instance in result.instance_id.tolist():
        last = [row for row in entities[f"/world/instances/{instance:04d}"] if "VoxelGridMap:voxel_indices" in row][-1]
        expected = result.voxel_index[result.voxel_instance == instance].tolist()
        assert sorted(last["VoxelGridMap:voxel_indices"]) == expected


def test_an_instance_that_does_not_change_is_not_logged_again(tmp_path: Path) -> None:
    frame = tiny_frames(1)[0]
    frames = [replace(frame, index=i, stamp_ns=frame.stamp_ns + i) for i in range(5)]
    steps, result = watched(tmp_path / "still.rrd", frames)
    assert len(steps) == 5
    for instance in result.instance_id.tolist():
        drawn = rows(tmp_path / "still.rrd")[f"/world/instances/{instance:04d}"]
        # the first frame and the finished map
        assert [row["frame"] for row in drawn if "VoxelGridMap:voxel_indices" in row] == [0, 4]


def test_without_images_there_are_no_pictures(tmp_path: Path) -> None:
    watched(tmp_path / "bare.rrd", tiny_frames(2), images=False)
    assert not any("EncodedImage:blob" in row for row in rows(tmp_path / "bare.rrd").get("/camera/detected/color", []))


def test_a_frame_that_was_not_looked_at_says_so(tmp_path: Path) -> None:
    mapper = Mapper(PARAMETERS)
    with RerunObserver(tmp_path / "a.rrd", voxel_size=SIZE) as observer:
        observer.on_step(mapper.step(tiny_frames(1)[0], None))
        observer.close(mapper.finish())
    (row,) = rows(tmp_path / "a.rrd")["/decisions/table"]
    assert "did not look" in row["TextDocument:text"][0]


def test_equal_runs_give_equal_files_for_rerun(tmp_path: Path, run: Run) -> None:
    watched(tmp_path / "run.rrd", tiny_frames(4))
    command = [sys.executable, "-m", "rerun", "rrd", "compare", "--unordered", str(run[0]), str(tmp_path / "run.rrd")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-500:]


def test_an_aborted_run_leaves_nothing_and_harms_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.rrd").write_bytes(b"older")
    with pytest.raises(RuntimeError, match="stop"), RerunObserver(tmp_path / "a.rrd", voxel_size=SIZE):
        raise RuntimeError("stop")
    assert (tmp_path / "a.rrd").read_bytes() == b"older"
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


def test_a_file_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere/a\.rrd could not be written"):
        RerunObserver(tmp_path / "nowhere" / "a.rrd", voxel_size=SIZE)
