"""compare: the first difference of two runs, and what became of the instances."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from maps import labelled_map
from rerun.chunk import RrdReader
from test_cli import run
from worlds import tiny_frames, truth_masks

from openvox.apps.compare import compare, first_outcome
from openvox.apps.comparing import arrays
from openvox.apps.comparing.decisions import FIELDS, first_difference
from openvox.apps.comparing.drawing import kinds_of_voxels, markdown
from openvox.apps.comparing.matching import differing_voxels, match_instances
from openvox.core.errors import InputError, OutputError
from openvox.core.fixedpoint import Q20
from openvox.core.types import Candidate, Decision, InstanceMap, Step, VoxelChanges
from openvox.formats.map_npz import write_map
from openvox.formats.trace import TraceWriter, read_decisions
from openvox.view.differences import ELSEWHERE, GONE, MERGED, NEW, SAME, SPLIT

NONE = np.zeros(0, np.int32)


def row_of(*labels: int, size: float = 0.04, **options: Any) -> InstanceMap:
    """A row of voxels along x with these labels, 0 = background."""
    index = np.array([(x, 0, 0) for x in range(len(labels))], np.int32).reshape(-1, 3)
    return labelled_map(index, np.array(labels, np.int32), voxel_size=size, **options)


# ---- instances -------------------------------------------------------------------------------------------------------


def test_an_instance_in_two_pieces_is_split_and_the_larger_piece_is_its_match() -> None:
    found = match_instances(row_of(1, 1, 1, 1, 1), row_of(7, 7, 7, 3, 3))
    assert [(m.a, m.b, m.iou) for m in found.matches] == [(1, 7, pytest.approx(3 / 5))]
    assert found.split == {1: (7, 3)}
    assert (found.merged, found.appeared, found.vanished) == ({}, (), ())


def test_two_instances_in_one_are_merged() -> None:
    found = match_instances(row_of(7, 7, 7, 3, 3), row_of(1, 1, 1, 1, 1))
    assert [(m.a, m.b) for m in found.matches] == [(7, 1)]
    assert found.merged == {1: (3, 7)}
    assert (found.split, found.appeared, found.vanished) == ({}, (), ())


def test_what_has_no_counterpart_appeared_or_vanished() -> None:
    found = match_instances(row_of(1, 1, 0, 2, 2, 2), row_of(1, 1, 5, 0, 0, 9))
    assert [(m.a, m.b) for m in found.matches] == [(1, 1), (2, 9)]  # 9 lies in 2, whatever is left of it
    assert (found.appeared, found.vanished) == ((5,), ())
    assert match_instances(row_of(0, 4), row_of(0, 0)).vanished == (4,)


def test_a_tie_goes_to_the_lowest_ids() -> None:
    found = match_instances(row_of(1, 1, 1, 1), row_of(5, 5, 4, 4))
    assert [(m.a, m.b) for m in found.matches] == [(1, 4)]
    assert found.split == {1: (4, 5)}


def test_maps_of_two_voxel_sizes_are_compared_by_place() -> None:
    coarse, fine = row_of(1, 2, size=0.08), row_of(3, 3, 6, 6, size=0.04)
    found = match_instances(coarse, fine)
    assert [(m.a, m.b, m.iou) for m in found.matches] == [(1, 3, 1.0), (2, 6, 1.0)]


def test_iou_is_that_of_sets_of_voxels() -> None:
    found = match_instances(row_of(1, 1, 1, 0), row_of(0, 2, 2, 2))
    assert found.matches[0].iou == pytest.approx(2 / 4)


def test_a_crumb_does_not_take_the_match_of_what_mostly_went_elsewhere() -> None:
    """2 lies mostly in 8, beside 1, and left a crumb of itself, 9: it was merged, not renamed to the crumb."""
    found = match_instances(row_of(1, 1, 1, 1, 1, 2, 2, 2, 2), row_of(8, 8, 8, 8, 8, 8, 8, 8, 9))
    assert [(m.a, m.b) for m in found.matches] == [(1, 8)]
    assert found.merged == {8: (1, 2)}
    assert (found.split, found.appeared, found.vanished) == ({}, (9,), ())


def test_a_crumb_of_what_was_lost_is_no_match() -> None:
    found = match_instances(row_of(*[1] * 11), row_of(4, *[0] * 10))
    assert (found.matches, found.appeared, found.vanished) == ((), (4,), (1,))


def test_the_largest_of_many_crumbs_is_the_match_of_what_broke_into_them() -> None:
    found = match_instances(row_of(*[1] * 24), row_of(*[1 + x // 2 for x in range(24)]))
    assert [(m.a, m.b) for m in found.matches] == [(1, 1)]
    assert found.split == {1: tuple(range(1, 13))}
    back = match_instances(row_of(*[1 + x // 2 for x in range(24)]), row_of(*[1] * 24))
    assert back.merged == {1: tuple(range(1, 13))}


LABELS = st.lists(st.integers(0, 4), min_size=1, max_size=12)


@settings(deadline=None)
@given(a=LABELS, b=LABELS)
def test_every_instance_is_in_exactly_one_place(a: list[int], b: list[int]) -> None:
    one, other = row_of(*a), row_of(*b)
    found = match_instances(one, other)
    of_a = [m.a for m in found.matches] + list(found.vanished)
    of_a += [i for j, parts in found.merged.items() for i in parts if (i, j) not in {(m.a, m.b) for m in found.matches}]
    of_b = [m.b for m in found.matches] + list(found.appeared)
    of_b += [j for i, parts in found.split.items() for j in parts if (i, j) not in {(m.a, m.b) for m in found.matches}]
    assert sorted(of_a) == one.instance_id.tolist()
    assert set(found.split) <= {m.a for m in found.matches}
    assert set(found.merged) <= {m.b for m in found.matches}
    assert sorted(of_b) == other.instance_id.tolist()


@settings(deadline=None)
@given(a=LABELS, b=LABELS)
def test_the_other_way_round_split_is_merged_and_appeared_is_vanished(a: list[int], b: list[int]) -> None:
    there, back = match_instances(row_of(*a), row_of(*b)), match_instances(row_of(*b), row_of(*a))
    assert (there.appeared, there.vanished) == (back.vanished, back.appeared)
    assert sum(len(m) for m in (there.split, back.split)) == sum(len(m) for m in (back.merged, there.merged))


@settings(deadline=None)
@given(labels=LABELS)
def test_a_map_differs_nowhere_from_itself(labels: list[int]) -> None:
    one = row_of(*labels)
    found = match_instances(one, one)
    assert all(m.a == m.b and m.iou == 1.0 for m in found.matches)
    assert not any(differing.any() for differing in differing_voxels(found, one, one))


def test_each_voxel_is_drawn_as_what_became_of_its_instance() -> None:
    a = row_of(1, 1, 1, 2, 2, 3, 4, 0, 5, 5, 5)
    b = row_of(8, 8, 9, 7, 7, 7, 0, 6, 5, 5, 0)
    in_a, in_b = kinds_of_voxels(match_instances(a, b), a, b)
    assert in_a.tolist() == [SPLIT] * 3 + [MERGED] * 3 + [GONE, ELSEWHERE, SAME, SAME, ELSEWHERE]
    assert in_b.tolist() == [SPLIT] * 3 + [MERGED] * 3 + [ELSEWHERE, NEW, SAME, SAME, ELSEWHERE]


# ---- maps ------------------------------------------------------------------------------------------------------------


def test_the_first_number_that_differs_in_two_maps() -> None:
    one = row_of(1, 1, 2)
    assert arrays.first_difference(one, one) is None
    other = replace(one, voxel_instance=np.array([1, 2, 2], np.int32))
    assert arrays.first_difference(one, other) == {"field": "voxel_instance", "row": 1, "a": 1, "b": 2}
    longer = row_of(1, 1, 2, 2)
    assert arrays.first_difference(one, longer) == {"field": "voxel_index", "row": 3, "a": None, "b": [3, 0, 0]}
    assert arrays.first_difference(one, row_of(1, 1, 2, size=0.05)) == {
        "field": "voxel_size",
        "row": None,
        "a": 0.04,
        "b": 0.05,
    }


def written(path: Path, result: InstanceMap) -> Path:
    write_map(path, result)
    return path


def test_the_contract_of_two_maps(tmp_path: Path) -> None:
    meta = {"parameters": {"map.voxel_size": 0.04, "masks.erosion": 1}, "preset": "openvox", "digests": {}}
    other = {**meta, "parameters": {"map.voxel_size": 0.04, "masks.erosion": 2}}
    a = written(tmp_path / "a.map.npz", row_of(1, 1, 2, 2, 2, 3, 0, meta=meta, captions={1: "lamp"}))
    b = written(tmp_path / "b.map.npz", row_of(1, 1, 2, 2, 4, 0, 5, meta=other, captions={1: "light"}))
    found = compare(a, b)
    assert found["same"] is False
    assert found["first_difference"] == {"field": "vote_fragment", "row": 4, "a": 2, "b": 4}
    assert found["parameters"] == {"masks.erosion": {"a": 1, "b": 2}}
    assert found["instances"] == {"split": [2], "merged": [], "appeared": [5], "vanished": [3], "renamed": [1]}
    assert found["agreement"] == pytest.approx(4 / 6)
    assert "no trace" in found["notes"][0]


def test_equal_maps_are_the_same(tmp_path: Path) -> None:
    a, b = (written(tmp_path / f"{name}.map.npz", row_of(1, 0, 2)) for name in "ab")
    found = compare(a, b)
    assert (found["same"], found["first_difference"]) == (True, None)
    assert found["instances"] == {"split": [], "merged": [], "appeared": [], "vanished": [], "renamed": []}


# ---- traces ----------------------------------------------------------------------------------------------------------


def decision(mask: int, **changes: Any) -> Decision:
    fields: dict[str, Any] = {
        "mask": mask,
        "by": "threshold",
        "instance": 1,
        "fragment": 1,
        "held": (1,),
        "voxels": 9,
        "abstained": 0,
        "s_geo": Q20 // 2,
        "s_fea": Q20,
        "a": Q20 // 2,
        "threshold": Q20 // 4,
        "visibility": Q20,
        "credibility": 4096,
        "candidates": (Candidate(1, 5, Q20 // 2, Q20, Q20 // 2),),
    }
    return Decision(**{**fields, **changes})


def traced(path: Path, *frames: tuple[Decision, ...] | None, parameters: dict[str, Any] | None = None) -> Path:
    """A trace of these decisions; None: nobody looked at that frame."""
    nothing = VoxelChanges(0, np.zeros((0, 3), np.int32), *[NONE] * 6)
    with TraceWriter(path, {"preset": "openvox", "parameters": parameters or {}, "sources": {}}) as writer:
        for frame, decisions in zip(tiny_frames(len(frames)), frames, strict=True):
            masks = truth_masks(frame)
            writer.on_step(Step(frame, masks, decisions is not None, decisions or (), (), nothing, {}, 0))
        writer.close(row_of(1))
    return path


def pair(tmp_path: Path, a: Any, b: Any, **options: Any) -> dict[str, Any]:
    return compare(traced(tmp_path / "a.trace.mcap", *a), traced(tmp_path / "b.trace.mcap", *b, **options))


def test_the_first_frame_mask_and_field_of_two_traces_causes_first(tmp_path: Path) -> None:
    same = (decision(0), decision(1))
    other = (decision(0), decision(1, by="new", candidates=(Candidate(1, 5, Q20 // 4, Q20, Q20 // 4),)))
    found = pair(tmp_path, [same, same, same], [same, other, other])
    assert not found["same"]
    first = {name: found["first_difference"][name] for name in ("frame", "mask", "field", "a", "b")}
    assert first == {"frame": 1, "mask": 1, "field": "candidates[0].s_geo", "a": 0.5, "b": 0.25}
    assert found["first_outcome"]["field"] == "by"
    assert found["instances"] is None


def test_scores_alone_may_differ(tmp_path: Path) -> None:
    found = pair(tmp_path, [(decision(0),)], [(decision(0, visibility=0),)])
    assert found["first_difference"]["field"] == "visibility"
    assert found["first_outcome"] is None
    assert first_outcome(tmp_path / "a.trace.mcap", tmp_path / "b.trace.mcap") is None


def test_a_threshold_that_was_set_differently_is_no_news(tmp_path: Path) -> None:
    other = {"association.threshold": 0.5}
    changed, late = decision(0, threshold=Q20 // 2), decision(0, threshold=Q20 // 2, by="new")
    found = pair(tmp_path, [(decision(0),)] * 2, [(changed,), (late,)], parameters=other)
    assert (found["first_difference"]["frame"], found["first_difference"]["field"]) == (1, "by")
    found = pair(tmp_path, [(decision(0),)], [(changed,)], parameters=other)
    assert (found["first_difference"]["field"], found["first_outcome"]) == ("threshold", None)


@pytest.mark.parametrize(
    ("a", "b", "field", "values"),
    [
        ([(decision(0),)], [(decision(0), decision(1))], "masks", (1, 2)),
        ([(), ()], [()], "frame", (1, None)),
        ([None], [()], "looked", (False, True)),
        ([(decision(0, candidates=()),)], [(decision(0),)], "candidates[0].instance", (None, 1)),
    ],
)
def test_frames_themselves_may_differ(tmp_path: Path, a: Any, b: Any, field: str, values: Any) -> None:
    one, other = traced(tmp_path / "a.trace.mcap", *a), traced(tmp_path / "b.trace.mcap", *b)
    found = first_difference(one, other, FIELDS)
    assert found is not None
    assert (found.field, (found.a, found.b)) == (field, values)


def test_reading_stops_at_the_first_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []

    def noting(path: Path, start: int = 0) -> Any:
        for frame in read_decisions(path, start):
            read.append(frame["frame"])
            yield frame

    monkeypatch.setattr("openvox.apps.comparing.decisions.read_decisions", noting)
    one = traced(tmp_path / "a.trace.mcap", *[(decision(0),)] * 5)
    other = traced(tmp_path / "b.trace.mcap", *[(decision(0, by="new"),)] * 5)
    assert first_difference(one, other, FIELDS) is not None
    assert read == [0, 0]


def test_a_map_knows_the_decisions_of_the_trace_beside_it_and_the_other_way_round(tmp_path: Path) -> None:
    for name, by in (("a", "threshold"), ("b", "new")):
        with_trace = traced(tmp_path / f"{name}.trace.mcap", (decision(0, by=by),))
        digests = {"digests": {"trace": compare(with_trace, with_trace)["a"]["trace_digest"]}}
        written(tmp_path / f"{name}.map.npz", row_of(1, 1, meta={**digests, "parameters": {}}))
    found = compare(tmp_path / "a.map.npz", tmp_path / "b.map.npz")
    assert found["first_decision"]["field"] == "by"
    found = compare(tmp_path / "a.trace.mcap", tmp_path / "b.trace.mcap")
    assert found["instances"]["split"] == []
    written(tmp_path / "b.map.npz", row_of(1, 1))  # of another run
    assert compare(tmp_path / "a.map.npz", tmp_path / "b.map.npz")["first_decision"] is None


# ---- the command -----------------------------------------------------------------------------------------------------


def test_what_cannot_be_compared_is_said(tmp_path: Path) -> None:
    a = written(tmp_path / "a.map.npz", row_of(1))
    trace = traced(tmp_path / "t.trace.mcap", ())
    with pytest.raises(InputError, match=r"a\.map\.npz is a map, .*t\.trace\.mcap a trace; compare two maps or two"):
        compare(a, trace)
    with pytest.raises(InputError, match="draws maps, but no map lies beside"):
        compare(trace, trace, rerun=tmp_path / "d.rrd")
    (tmp_path / "x.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match="is a text file"):
        compare(a, tmp_path / "x.npz")
    assert not (tmp_path / "d.rrd").exists()


@pytest.mark.parametrize("victim", ["a.map.npz", "b.map.npz", "a.trace.mcap", "living.mcap", "a.perception.mcap"])
def test_the_picture_is_not_written_over_what_is_compared(tmp_path: Path, victim: str) -> None:
    meta = {"recording": "living.mcap", "perception": "a.perception.mcap"}
    a, b = (written(tmp_path / f"{name}.map.npz", row_of(1, 2, meta=meta)) for name in "ab")
    traced(tmp_path / "a.trace.mcap", (decision(0),))
    for name in ("living.mcap", "a.perception.mcap"):
        (tmp_path / name).write_bytes(b"hours of work")
    before = (tmp_path / victim).read_bytes()
    (tmp_path / "link.rrd").hardlink_to(tmp_path / victim)
    for out in (tmp_path / victim, tmp_path / "link.rrd"):
        with pytest.raises(OutputError, match="would be overwritten by what is made from it; choose another name"):
            compare(a, b, rerun=out)
    assert (tmp_path / victim).read_bytes() == before


def test_a_caption_that_the_other_also_got_is_no_other_name(tmp_path: Path) -> None:
    one = row_of(1, 1, captions={1: "lamp"})
    both = replace(one.instances[0], caption="light", captions=(("light", 2.0), ("lamp", 1.0)))
    a = written(tmp_path / "a.map.npz", one)
    b = written(tmp_path / "b.map.npz", replace(one, instances=(both,)))
    assert compare(a, b)["instances"]["renamed"] == []


def test_the_command_exits_with_3_where_they_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = written(tmp_path / "a.map.npz", row_of(1, 1, 1))
    b = written(tmp_path / "b.map.npz", row_of(1, 1, 2))
    assert run("compare", a, a, "--json") == 0
    assert json.loads(capsys.readouterr().out)["same"] is True
    assert run("compare", a, b) == 3
    printed = capsys.readouterr().out
    assert "the two maps are not the same" in printed
    assert "1 thing 1 (3) split 1 thing 1 (2), 2 thing 2 (1)" in " ".join(printed.split())


def test_both_maps_are_drawn_with_the_kinds_of_differences(tmp_path: Path) -> None:
    a = written(tmp_path / "a.map.npz", row_of(1, 1, 1, 4))
    b = written(tmp_path / "b.map.npz", row_of(1, 1, 2, 4))
    compare(a, b, rerun=tmp_path / "d.rrd")
    drawn = {str(chunk.entity_path) for chunk in RrdReader(str(tmp_path / "d.rrd")).stream()}
    expected = {f"/{place}" for place in ("a/instances/0001", "a/instances/0004", "b/instances/0002", "differences")}
    assert expected <= drawn
    assert "/a/names/0001" in drawn
    assert "/a/names/0004" not in drawn


def test_a_drawing_never_replaces_a_map_that_it_shows(tmp_path: Path) -> None:
    a, b = (written(tmp_path / f"{name}.map.npz", row_of(1, *rest)) for name, rest in (("a", [1]), ("b", [2])))
    before = b.read_bytes()
    with pytest.raises(OutputError, match=r"b\.map\.npz would be overwritten"):
        compare(a, b, rerun=b)
    assert b.read_bytes() == before


def test_captions_are_no_markdown_in_the_drawing(tmp_path: Path) -> None:
    hostile = "![x](http://a/b) *cup*"
    a = written(tmp_path / "a.map.npz", row_of(1, 1, captions={1: hostile}))
    found = compare(a, written(tmp_path / "b.map.npz", row_of(0, 0)))
    assert markdown(found) == r"- vanished: 1 (!\[x\](http://a/b) \*cup\*, 2 voxels)"


def test_maps_that_note_no_digests_are_compared_all_the_same(tmp_path: Path) -> None:
    for name, noted in (("a.map.npz", None), ("b.map.npz", ["no", "object"])):
        write_map(tmp_path / name, replace(row_of(1, 1, 2), meta={"digests": noted}))
    assert compare(tmp_path / "a.map.npz", tmp_path / "b.map.npz")["same"]
