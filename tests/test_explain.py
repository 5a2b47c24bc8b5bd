"""explain: why a mask went where it went, the lives of instances and voxels, and what is likely wrong."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import tiny_frames, truth_masks

from openvox.apps.explain import explain
from openvox.apps.explaining import mask as mask_module
from openvox.apps.explaining.instance import explain_instance
from openvox.apps.explaining.run import Run, read_run, strongest, words_of
from openvox.apps.explaining.suspicious import Suspect, likeness, spread, words_in
from openvox.apps.explaining.voxel import owner_of
from openvox.apps.loop import run as run_loop
from openvox.cli import main
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import OPENVOX, PAPER, MapperParameters
from openvox.core.parameters import as_dict
from openvox.core.types import Frame, Intrinsics, Mask
from openvox.formats.trace import TraceWriter, read_trace, votes_after
from openvox.mapper.mapper import Mapper

CAMERA = Intrinsics(96, 72, 78.0, 78.0, 47.5, 35.5)
TINY = replace(
    OPENVOX,
    map=replace(OPENVOX.map, voxel_size=0.08),
    masks=replace(OPENVOX.masks, min_pixels=1),
    finish=replace(OPENVOX.finish, smoothing=0, rounds=0, holes=0.0, min_voxels=1, min_part=0.0, min_confidence=0.0),
)
WRONG = 3
"""The frame in which one mask lies on the floor, reaches over box 1, and has another name."""


def frames(n: int) -> list[Frame]:
    return tiny_frames(n, camera=CAMERA)


def traced(path: Path, masks: Sequence[Sequence[Mask]], parameters: MapperParameters = TINY) -> Path:
    """The trace of a run over the first tiny frames, each with its masks."""
    mapper = Mapper(parameters)
    with TraceWriter(path, {"parameters": as_dict(parameters)}) as trace:
        run_loop(zip(frames(len(masks)), masks, strict=True), mapper, [trace])
        trace.close(mapper.finish())
    return path


def masks_with_one_wrong(count: int = 7) -> list[tuple[Mask, ...]]:
    """True masks of every frame; in frame WRONG that of box 1 is half of it and much floor, and called a door."""
    out = [truth_masks(frame) for frame in frames(count)]
    first, *others = out[WRONG]
    bitmap = first.bitmap(CAMERA.height, CAMERA.width)
    rows, columns = np.nonzero(bitmap)
    bitmap[:, int(np.median(columns)) :] = False
    bitmap[int(rows.max()) : int(rows.max()) + 18, int(columns.min()) : int(columns.max())] = True
    out[WRONG] = (Mask.from_bitmap(bitmap, caption="a blue door"), *others)
    return out


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return traced(tmp_path_factory.mktemp("explain") / "tiny.trace.mcap", masks_with_one_wrong())


@pytest.fixture(scope="module")
def run(trace: Path) -> Run:
    return read_run(trace)


def test_a_mask_beside_its_object_with_another_name_is_the_first_suspect(trace: Path) -> None:
    found = explain(trace)["decisions"]
    assert {"frame", "mask", "instance", "score", "reason"} <= found[0].keys()
    assert (found[0]["frame"], found[0]["mask"]) == (WRONG, 0)
    assert found[0]["score"] == found[0]["elsewhere"] * (1 - found[0]["likeness"])
    assert 'it says "a blue door", 6 of 7 masks there say "thing 1"' in found[0]["reason"]
    assert [one["score"] for one in found] == sorted((one["score"] for one in found), reverse=True)
    assert len(explain(trace, top=1)["decisions"]) == 1


def test_nothing_is_suspicious_where_every_voxel_stays_and_every_caption_agrees(tmp_path: Path) -> None:
    perfect = [truth_masks(frame) for frame in frames(4)]
    assert explain(traced(tmp_path / "a.trace.mcap", perfect))["decisions"] == []


def test_likeness_is_the_mean_share_of_masks_that_have_each_word() -> None:
    words = words_in({"a grey chair": 3, "the chair": 1})
    assert words == {"grey": 3, "chair": 4, "the": 1}
    assert likeness("grey chair", words, 4) == (3 / 4 + 4 / 4) / 2
    assert likeness("a door", words, 4) == 0.0
    assert likeness("", words, 4) == 0.5  # says nothing, for or against


def test_words_are_those_of_any_language_without_the_short_ones() -> None:
    assert words_of("Ein großer Stuhl, a TV") == {"ein", "grosser", "stuhl"}


def test_three_suspects_of_an_instance_come_before_a_fourth_of_it() -> None:
    ranked = [Suspect(i, {"mask": i}, instance, 10, {}, 0.0) for i, instance in enumerate((7, 7, 7, 7, 9))]
    assert [one.position for one in spread(ranked)] == [0, 1, 2, 4, 3]


@pytest.mark.parametrize("parameters", [TINY, PAPER], ids=["openvox", "paper"])
def test_the_columns_are_the_votes_of_the_trace_after_every_frame(tmp_path: Path, parameters: MapperParameters) -> None:
    run = read_run(traced(tmp_path / "a.trace.mcap", masks_with_one_wrong(5), parameters))
    for position, found in enumerate(run.frames):
        index, counts = votes_after(run.path, found.frame)
        voxel, fragment, count = (part.tolist() for part in run.votes_at(position + 1))
        assert dict(zip(zip(voxel, fragment, strict=True), count, strict=True)) == counts
        assert run.index[: len(index)].tolist() == index.tolist()


def test_instances_of_the_trace_are_those_of_the_mapper(tmp_path: Path) -> None:
    mapper = Mapper(TINY)
    steps: list[dict[int, int]] = []
    masks = masks_with_one_wrong()
    run = read_run(traced(tmp_path / "a.trace.mcap", masks))
    for frame, found in zip(frames(len(masks)), masks, strict=True):
        steps.append(dict(mapper.step(frame, found).instance_of))
    assert [run.instances_before(position + 1) for position in range(len(steps))] == steps


def test_the_final_owner_is_what_the_map_shows_without_smoothing(run: Run) -> None:
    mapper = Mapper(TINY)
    for frame, masks in zip(frames(7), masks_with_one_wrong(), strict=True):
        mapper.step(frame, masks)
    result = mapper.finish()
    shown = {tuple(i): int(owner) for i, owner in zip(result.voxel_index.tolist(), result.voxel_instance, strict=True)}
    owner = run.final_owner
    assert {tuple(i): int(o) for i, o in zip(run.index.tolist(), owner, strict=True) if tuple(i) in shown} == shown


def test_ties_go_to_background_then_to_the_lowest_id() -> None:
    voxel, instance, count = (np.array(part) for part in ([0, 0, 1, 1, 2], [4, 3, 0, 5, 6], [2, 2, 3, 3, 1]))
    assert strongest(voxel, instance, count, 4).tolist() == [3, 0, 6, 0]
    assert owner_of({8: 2, 9: 2}, {8: 4, 9: 3}) == 3
    assert owner_of({0: 3, 8: 3}, {8: 4}) == 0
    assert owner_of({8: 2, 9: 2, 0: 3}, {8: 4, 9: 4}) == 4  # two fragments of one instance count together
    assert owner_of({-1: 9, 8: 1}, {8: 4}) == 4  # votes without a name are nobody's


def test_a_mask_is_told_with_candidates_margins_and_what_the_scores_consist_of(trace: Path) -> None:
    found = explain(trace, frame=2, mask=0)
    best = found["candidates"][0]
    assert (found["by"], found["instance"], best["chosen"]) == ("containment", best["instance"], True)
    assert best["a"] == pytest.approx(best["from_geometry"] + best["from_feature"], abs=1e-5)
    assert found["scores"]["a"] == best["a"]
    assert found["margin"]["best_minus_threshold"] == best["a"] - found["scores"]["threshold"]
    assert best["caption"] == "thing 1"
    assert found["evidence"][0]["caption_likeness"] == 1.0
    assert found["evidence"][0]["masks_before"] == 2
    assert found["history"]["masks_before"] == 2
    assert found["history"]["masks_after"] == 4
    assert "containment" in found["verdict"]


def test_contributions_add_up_to_the_geometric_score(trace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(explain(trace, frame=2, mask=0)["contributions"][0]["largest"]) == 10
    monkeypatch.setattr(mask_module, "CONTRIBUTIONS", 10**6)
    found = explain(trace, frame=2, mask=0)
    assert found["voted"] == found["voxels"]
    parts = [row["of_s_geo"] for row in found["contributions"][0]["largest"]]
    assert sum(parts) == pytest.approx(found["scores"]["s_geo"], abs=1e-5)
    assert parts == sorted(parts, reverse=True)


def test_a_founder_has_no_score_and_says_what_a_alone_would_have_done(trace: Path) -> None:
    found = explain(trace, frame=0, mask=1)
    assert (found["by"], found["candidates"], found["contributions"]) == ("new", [], [])
    assert found["margin"] == {"best_minus_threshold": None, "best_minus_second": None, "chosen_minus_rival": None}
    assert "by A and the threshold alone it would found a new instance" in found["verdict"]


def test_a_rule_that_overrules_the_threshold_is_named_as_odd(tmp_path: Path) -> None:
    strict = replace(TINY, association=replace(TINY.association, threshold=1.0))
    path = traced(tmp_path / "a.trace.mcap", masks_with_one_wrong(4), strict)
    assert any("containment overruled the threshold" in sign for sign in explain(path, frame=2, mask=0)["signs"])


def test_an_instance_is_told_with_its_masks_captions_and_growth(trace: Path, run: Run) -> None:
    instance = run.final[run.frames[0].decisions[0]["fragment"]]
    found = explain(trace, instance=instance)
    assert [one["frame"] for one in found["masks"]] == [0, 1, 2, 3, 4, 5, 6]
    assert found["captions"] == [{"caption": "thing 1", "masks": 6}, {"caption": "a blue door", "masks": 1}]
    sizes = [step["voxels"] for step in found["growth"]]
    assert sizes == sorted(set(sizes))
    assert found["voxels"] == int((run.final_owner == instance).sum()) > 0
    assert [event["kind"] for event in found["events"]][:2] == ["new", "confirmed"]
    assert found["state"] == f"confirmed in frame {found['events'][1]['frame']}"


def test_an_instance_of_the_run_that_was_resumed_is_known_without_masks(run: Run) -> None:
    silent = tuple(replace(frame, decisions=(), events=()) for frame in run.frames)
    found = explain_instance(replace(run, frames=silent), run.final[run.frames[0].decisions[0]["fragment"]])
    assert (found["state"], found["masks"]) == ("of the run before this one", [])
    assert found["voxels"] > 0


def test_a_voxel_tells_who_voted_and_what_it_holds(trace: Path, run: Run) -> None:
    largest = explain(trace, frame=2, mask=0)["contributions"][0]["largest"][0]
    found = explain(trace, at=largest["center"])
    assert found["center"] == largest["center"]
    assert found["history"][0]["owner_before"] == 0
    votes = found["history"][0]["votes"][0]
    assert (votes["votes_before"], votes["votes"], votes["masks"], votes["captions"]) == (
        0.0,
        2.0,
        [0],
        ["thing 1"],
    )  # twice at 2 m
    number = int(np.flatnonzero((run.index == found["voxel"]).all(1))[0])
    assert found["now"]["owner"] == found["history"][-1]["owner"] == int(run.final_owner[number])
    assert sum(vote["share"] for vote in found["now"]["votes"]) == pytest.approx(1.0)


def test_a_frame_is_told_without_reading_the_run(trace: Path) -> None:
    assert len(explain(trace, frame=WRONG)["decisions"]) == len(masks_with_one_wrong()[WRONG])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"frame": 99, "mask": 0}, "frame 99 was not mapped; it holds 7 frames"),
        ({"frame": 2, "mask": 9}, "frame 2 has 3 masks, numbered from 0, and no 9"),
        ({"instance": 999}, "there was never an instance 999; in the end there are 1, 2, 3"),
        ({"at": (90.0, 0.0, 0.0)}, "no voxel at 90,0,0 ever got a vote; the nearest lies 8"),
        ({"at": (float("nan"), 0.0, 0.0)}, "no voxel can lie at nan,0,0"),
    ],
)
def test_what_is_not_there_is_one_sentence(trace: Path, options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        explain(trace, **options)
    assert str(caught.value).startswith(str(trace))


def test_a_trace_that_does_not_group_fragments_is_refused(trace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    older = [replace(found, regrouped=()) for found in read_trace(trace)]
    monkeypatch.setattr("openvox.apps.explaining.run.read_trace", lambda path: iter(older))
    with pytest.raises(InputError, match="replay again"):
        explain(trace)


def test_a_run_without_masks_has_nothing_suspicious(tmp_path: Path) -> None:
    path = traced(tmp_path / "a.trace.mcap", [(), ()])
    assert explain(path)["decisions"] == []
    with pytest.raises(InputError, match="there was never an instance 1; in the end there are none"):
        explain(path, instance=1)


def cli(*words: str | Path) -> int:
    with pytest.raises(SystemExit) as end:
        main(["explain", *map(str, words)])
    assert isinstance(end.value.code, int)
    return end.value.code


@pytest.mark.parametrize(
    "words",
    [
        ("--frame", "1", "--suspicious"),
        ("--instance", "1", "--at", "0,0,0"),
        ("--mask", "1"),
        ("--instance", "1", "--mask", "1"),
        ("--frame", "1", "--top", "3"),
        ("--at", "1,2"),
        ("--suspicious", "--top", "0"),
    ],
)
def test_options_that_do_not_go_together_are_wrong_usage(words: tuple[str, ...], trace: Path) -> None:
    assert cli(trace, *words) == 2


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--suspicious", "--top", "2"), "next: openvox explain"),
        (("--frame", "2", "--mask", "0"), "A = 0.8 S_geo + 0.2 S_fea; threshold 0.400 (419430/2^20)"),
        (("--frame", str(WRONG), "--mask", "0"), '"a blue door"'),
        (("--instance", "1"), "instance 1: confirmed in frame"),
        (("--at", "-0.55,1.65,0.45"), "background -> "),
    ],
)
def test_each_answer_reads_as_text_and_as_json(
    words: tuple[str, ...], says: str, trace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli(trace, *words) == 0
    assert says in capsys.readouterr().out
    assert cli(trace, *words, "--json") == 0
    assert isinstance(json.loads(capsys.readouterr().out), dict)


def explain_lines_of_the_tutorial() -> list[str]:
    text = (Path(__file__).resolve().parents[1] / "docs" / "debugging.md").read_text("utf-8")
    return sorted(set(re.findall(r"`openvox explain hard\.trace\.mcap ([^`]+)`", text)))


@pytest.mark.parametrize("line", explain_lines_of_the_tutorial())
def test_the_tutorial_types_what_explain_takes(line: str, trace: Path) -> None:
    assert cli(trace, *line.split()) in (0, 1)  # 1: the tiny world has no such frame, instance or place


def test_the_tutorial_asks_each_question() -> None:
    asked = {line.split()[0] for line in explain_lines_of_the_tutorial()}
    assert asked == {"--suspicious", "--frame", "--instance", "--at"}


def test_a_list_without_suspects_ends_with_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli(traced(tmp_path / "a.trace.mcap", [()]), "--suspicious") == 0
    assert capsys.readouterr().out.startswith("nothing is suspicious")
