"""sweep: all combinations, what is done is not done again, a dying process costs only its item."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from test_cli import run
from worlds import tiny_frames

from openvox.apps.evaluate import evaluate
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.apps.sweep import sweep
from openvox.apps.sweeping import shared
from openvox.apps.sweeping.plan import Run, parameter_sets
from openvox.apps.sweeping.pool import in_processes
from openvox.apps.sweeping.shared import shared_frames
from openvox.apps.sweeping.summary import best, described_sets, effects
from openvox.core.errors import InputError
from openvox.formats.recording import RecordingWriter

RUN = Run(preset="openvox", params=None, engine="cpu", start=None, end=None, stride=1)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return recorded(tmp_path / "tiny.mcap", 4)


def recorded(path: Path, frames: int) -> Path:
    """Frames of a tiny world with its truth as masks."""
    with RecordingWriter(path, source="test", categories={1: "box", 2: "ball"}) as writer:
        for frame in tiny_frames(frames):
            writer.add(frame)
    perceive(path, frontend="oracle", assignments=["oracle.min_pixels=1"])
    return path


# ---- what is asked for -----------------------------------------------------------------------------------------------


def test_all_combinations_the_last_parameter_fastest_and_the_default() -> None:
    varied, sets = parameter_sets(RUN, ["association.threshold=0.2,0.3", "masks.erosion=1,2"])
    assert varied == {"association.threshold": [0.2, 0.3], "masks.erosion": [1, 2]}
    assert [tuple(one.values.values()) for one in sets] == [(0.2, 1), (0.2, 2), (0.3, 1), (0.3, 2), (0.4, 0)]
    assert [one.grid for one in sets] == [True] * 4 + [False]
    assert [one.default for one in sets] == [False] * 4 + [True]


def test_the_default_is_not_mapped_twice() -> None:
    _, sets = parameter_sets(RUN, ["association.threshold=0.2,0.4"])
    assert [(one.number, one.default, one.grid) for one in sets] == [(0, False, True), (1, True, True)]


def test_a_single_value_holds_for_every_set() -> None:
    varied, sets = parameter_sets(RUN, ["map.voxel_size=0.08", "masks.erosion=0,1"])
    assert varied == {"masks.erosion": [0, 1]}
    assert [one.parameters["map.voxel_size"] for one in sets] == [0.08, 0.08]
    assert sets[0].default


def test_single_values_alone_are_compared_with_the_presets_own() -> None:
    varied, sets = parameter_sets(RUN, ["association.threshold=0.2"])
    assert varied == {"association.threshold": [0.2]}
    assert [(one.values["association.threshold"], one.default) for one in sets] == [(0.2, False), (0.4, True)]


def test_sets_hardly_behind_the_best_are_told() -> None:
    _, sets = parameter_sets(RUN, ["masks.erosion=0,1,2"])
    found = best(described_sets(sets, [item(0, 0.5), item(1, 0.4995), item(2, 0.49)]))
    assert found is not None
    assert (found["set"], found["ties"]) == (0, [1])


@pytest.mark.parametrize(
    ("sets", "sentence"),
    [
        ([], "--set is missing"),
        (["association.threshhold=0.2,0.3"], "no parameter 'association.threshhold'; did you mean"),
        (["association.threshold="], "expected group.key=value"),
        (["association.threshold=0.2,,0.3"], "a value is empty"),
        (["association.threshold=0.3,0.30"], "a value is given twice"),
        (["association.threshold=0.3,1.5"], r"association.threshold is 1.5; expected 0 \.\. 1"),
        (["association.threshold=0.3", "association.threshold=0.4"], "is given twice"),
        (["masks.erosion=0,1,2,3", *(f"{n}=0.1,0.2,0.3,0.4,0.5,0.6" for n in "abcdefgh")], "combinations"),
    ],
)
def test_values_that_cannot_be_are_refused(sets: list[str], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        parameter_sets(RUN, sets)


# ---- the whole -------------------------------------------------------------------------------------------------------

SETS = ["masks.min_pixels=0", "map.voxel_size=0.05,0.2"]


def test_an_item_is_what_replay_and_evaluate_make(recording: Path, tmp_path: Path) -> None:
    found = sweep([recording], assignments=SETS, out=tmp_path / "out", truths=[recording], jobs=1)
    assert [row["parameters"]["map.voxel_size"] for row in found["items"]] == [0.05, 0.2, 0.04]
    assert [row["status"] for row in found["items"]] == ["done"] * 3
    alone = replay(recording, assignments=["masks.min_pixels=0", "map.voxel_size=0.2"], out=str(tmp_path / "alone"))
    item = found["items"][1]
    assert item["digests"] == {**alone["digests"], "perception": found["recordings"][0]["digests"]["perception"]}
    scored = evaluate(tmp_path / "out" / item["outputs"]["map"], truth=recording)["instances"]
    assert item["scores"] == scored
    assert found["best"]["default_score"] == found["items"][2]["scores"]["ap"]
    assert item["first_outcome"]["a"] != item["first_outcome"]["b"]
    assert found["items"][2]["first_outcome"] is None


def test_the_files_say_the_same(recording: Path, tmp_path: Path) -> None:
    found = sweep([recording], assignments=SETS, out=tmp_path / "out", jobs=1)
    written = json.loads((tmp_path / "out" / "sweep.json").read_text())
    assert written == {name: value for name, value in found.items() if name != "outputs"}
    assert "map.voxel_size" in (tmp_path / "out" / "index.html").read_text()
    rows = list(csv.DictReader(io.StringIO((tmp_path / "out" / "table.csv").read_text())))
    assert [row["map.voxel_size"] for row in rows] == ["0.05", "0.2", "0.04"]
    assert [row["map_digest"] for row in rows] == [item["digests"]["map"] for item in found["items"]]
    assert (found["measure"], found["best"]) == (None, None)


def test_what_is_there_is_not_mapped_again(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = sweep([recording], assignments=SETS, out=out, jobs=2)
    stamps = {path: path.stat().st_mtime_ns for path in out.glob("items/*.npz")}
    broken = out / first["items"][0]["outputs"]["map"]
    broken.write_bytes(broken.read_bytes()[:-40])
    more = ["masks.min_pixels=0", "map.voxel_size=0.05,0.2,0.1"]
    again = sweep([recording], assignments=more, out=out, truths=[recording], jobs=1)
    assert [row["reused"] for row in again["items"]] == [False, True, False, True]
    assert [row["digests"] for row in again["items"][:2]] == [row["digests"] for row in first["items"][:2]]
    assert all(row["scores"]["ap"] is not None for row in again["items"])  # truth came later
    kept = out / first["items"][1]["outputs"]["map"]
    assert kept.stat().st_mtime_ns == stamps[kept]


def test_an_item_that_fails_is_reported_and_the_others_go_on(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = recorded(tmp_path / "other.mcap", 3)
    masks = other.with_suffix(".perception.mcap")
    masks.write_bytes(damaged(masks.read_bytes()))
    words = ["sweep", recording, other, "--set", "masks.min_pixels=0,1", "--out", tmp_path / "out", "--jobs", "1"]
    assert run(*words, "--json") == 3
    found = json.loads(capsys.readouterr().out)
    assert found["failed"] == 3
    assert {(row["recording"], row["status"]) for row in found["items"]} == {("tiny", "done"), ("other", "failed")}
    assert "other.perception.mcap is damaged" in found["items"][3]["error"]
    assert [one["failed"] for one in found["sets"]] == [1, 1, 1]
    assert run(*words) == 3
    assert "item 3 (other, set 0) failed: " in capsys.readouterr().out


def damaged(data: bytes) -> bytes:
    """One byte changed in the middle of the data, which only reading masks meets."""
    middle = len(data) // 3
    return data[:middle] + bytes([data[middle] ^ 255]) + data[middle + 1 :]


@pytest.mark.parametrize("case", ["no perception", "truths", "perceptions", "twice", "jobs"])
def test_what_does_not_fit_together_is_one_sentence_and_nothing_is_made(
    recording: Path, tmp_path: Path, case: str
) -> None:
    options: dict[str, Any] = {
        "no perception": {"recordings": [recording], "perceptions": [tmp_path / "none.perception.mcap"]},
        "truths": {"recordings": [recording], "truths": [recording, recording]},
        "perceptions": {"recordings": [recording], "perceptions": [recording, recording]},
        "twice": {"recordings": [recording, recording]},
        "jobs": {"recordings": [recording], "jobs": 0},
    }[case]
    sentence = {
        "no perception": "none.perception.mcap: no such file",
        "truths": "--truth is given 2 times for 1 recordings; expected one for each, in their order, or one for all",
        "perceptions": "--perception is given 2 times for 1 recordings",
        "twice": "are the same",
        "jobs": "--jobs is 0",
    }[case]
    with pytest.raises(InputError, match=sentence):
        sweep(out=tmp_path / "out", assignments=["masks.erosion=0,1"], **options)
    assert not (tmp_path / "out").exists()


def test_a_folder_of_something_else_is_left_alone(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("all of it")
    with pytest.raises(InputError, match="holds something that is no sweep"):
        sweep([recording], assignments=SETS, out=out)
    assert [path.name for path in out.iterdir()] == ["thesis.tex"]
    (out / "thesis.tex").unlink()
    sweep([recording], assignments=SETS, out=out, jobs=1)
    before = (out / "sweep.json").read_bytes()
    with pytest.raises(InputError, match="holds a sweep of other recordings"):
        sweep([recording], assignments=SETS, out=out, preset_name="paper")
    assert (out / "sweep.json").read_bytes() == before


# ---- processes -------------------------------------------------------------------------------------------------------


def shaky(task: int) -> int:
    """Doubles; dies of 3, is wrong about 4."""
    if task == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 4:
        raise InputError("four is no number")
    return 2 * task


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_process_that_is_killed_costs_only_its_task(jobs: int) -> None:
    outcomes = sorted(in_processes(shaky, [1, 3, 4, 5, 6], jobs), key=lambda outcome: outcome.place)
    assert [outcome.result for outcome in outcomes] == [2, None, None, 10, 12]
    assert outcomes[1].error is not None
    assert "died (signal 9)" in outcomes[1].error
    assert outcomes[2].error == "four is no number"


def test_processes_end_with_who_asked_for_them() -> None:
    outcomes = in_processes(shaky, [1, 2, 5], 1)
    assert next(outcomes).result == 2
    outcomes.close()  # type: ignore[attr-defined]


# ---- what the items tell together ------------------------------------------------------------------------------------


def item(number: int, ap: float | None, **changes: Any) -> dict[str, Any]:
    scores = None if ap is None else dict.fromkeys(("ap50", "ap25", "f50", "miou", "spill"), 0.0)
    scores = scores and {
        **scores,
        **dict.fromkeys(("missed_share", "wrong_share", "predicted", "true", "split", "merged", "missed"), 0),
        "ap": ap,
    }
    return {"set": number, "status": "done", "seconds": 2.0, "voxels": 10, "instances": 4, "scores": scores, **changes}


def test_main_effects_are_means_over_the_grid() -> None:
    varied, sets = parameter_sets(RUN, ["association.threshold=0.2,0.3", "masks.erosion=1,2"])
    items = [item(number, ap) for number, ap in enumerate([0.1, 0.3, 0.5, 0.9, 0.7])]
    described = described_sets(sets, items)
    found = [row for row in effects(varied, described) if row["measure"] == "ap"]
    assert [row["parameter"] for row in found] == ["association.threshold", "masks.erosion"]
    means = [[pytest.approx(value["mean"]) for value in row["means"]] for row in found]
    assert means == [[0.2, 0.7], [0.3, 0.6]]  # without the default, which is not of the grid
    assert [row["range"] for row in found] == [pytest.approx(0.5), pytest.approx(0.3)]
    assert best(described) == {
        "set": 3,
        "parameters": {"association.threshold": 0.3, "masks.erosion": 2},
        "score": 0.9,
        "default_score": 0.7,
        "ties": [],
    }


def test_what_failed_takes_its_neighbours_out_of_the_main_effect() -> None:
    varied, sets = parameter_sets(RUN, ["association.threshold=0.3,0.4", "masks.erosion=1,2"])
    items = [item(0, None, status="failed"), *(item(number, ap) for number, ap in ((1, 0.3), (2, 0.5), (3, 0.9)))]
    found = {row["parameter"]: row for row in effects(varied, described_sets(sets, items)) if row["measure"] == "ap"}
    assert [(row["value"], row["mean"], row["sets"]) for row in found["association.threshold"]["means"]] == [
        (0.3, 0.3, 1),
        (0.4, 0.9, 1),
    ]
    assert [row["mean"] for row in found["masks.erosion"]["means"]] == [0.5, 0.9]


def test_a_set_that_failed_somewhere_is_not_ranked() -> None:
    _, sets = parameter_sets(RUN, ["masks.erosion=1,2"])
    items = [item(0, 0.5), item(0, 0.7), item(1, 0.9), item(1, None, status="failed")]
    described = described_sets(sets, items)
    assert described[0]["scores"]["ap"] == pytest.approx(0.6)
    assert (described[1]["scores"], described[1]["failed"]) == (None, 1)
    top = best(described)
    assert top is not None
    assert top["set"] == 0


def test_frames_are_decoded_once_for_items_of_one_recording(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = recording.with_suffix(".perception.mcap")
    first = list(shared_frames(recording, found, None, None, 1))
    assert [frame.index for frame, _ in first] == [0, 1, 2, 3]
    again = list(shared_frames(recording, found, None, None, 1))
    assert all(one is other for (one, _), (other, _) in zip(first, again, strict=True))
    assert [frame.index for frame, _ in shared_frames(recording, found, 1, None, 2)] == [1, 3]
    monkeypatch.setattr(shared, "LIMIT", 1)
    longer = list(shared_frames(recording, found, None, None, 1))
    after = list(shared_frames(recording, found, None, None, 1))
    assert [frame.index for frame, _ in after] == [0, 1, 2, 3]
    assert longer[0][0] is not after[0][0]
