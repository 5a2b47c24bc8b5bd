"""What one finds in Rerun about decisions and instances: data that equals the trace, graph, lives, tables, votes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from test_rerun_observer import (
    SIZE,
    Story,
    box_of_voxels,
    decision,
    finished,
    frames_of,
    mask,
    owned,
    record,
    rows,
    truth_masks,
)  # fmt: skip
from worlds import tiny_frames

from openvox.core.fixedpoint import Q20
from openvox.core.mapper_parameters import preset
from openvox.core.types import Candidate, Event, Frame, Intrinsics, Pose, Rig
from openvox.formats.trace import TraceWriter, read_trace
from openvox.mapper.mapper import Mapper
from openvox.view.best_views import WIDTH, BestViews, sheet
from openvox.view.decision_graph import decision_graph
from openvox.view.decision_table import margins
from openvox.view.instance_table import Row, markdown
from openvox.view.live_map import LiveMap
from openvox.view.lives import COLORS
from openvox.view.rerun_lives import lane
from openvox.view.rerun_observer import RerunObserver
from openvox.view.votes import finished_entropies, shares_and_entropies


def mapped(tmp_path: Path, n: int = 4) -> tuple[Path, Path]:
    """The trace and the Rerun file of one run over a tiny world."""
    mapper, trace, rrd = Mapper(preset("openvox")), tmp_path / "t.trace.mcap", tmp_path / "run.rrd"
    with TraceWriter(trace, {}) as writer, RerunObserver(rrd, voxel_size=0.04) as observer:
        for frame in tiny_frames(n):
            step = mapper.step(frame, tuple(truth_masks(frame)))
            writer.on_step(step)
            observer.on_step(step)
        result = mapper.finish()
        writer.close(result)
        observer.close(result)
    return trace, rrd


def test_every_decision_and_candidate_in_the_file_is_that_of_the_trace(tmp_path: Path) -> None:
    trace, rrd = mapped(tmp_path)
    told = list(read_trace(trace))
    decisions, candidates = rows(rrd, "decisions/data"), rows(rrd, "decisions/candidates")
    assert [row["frame"] for row in decisions] == [row["frame"] for row in candidates] == [one.frame for one in told]
    assert sum(len(row["a"]) for row in candidates) > 0
    for frame, data, options in zip(told, decisions, candidates, strict=True):
        for name in ("mask", "instance", "fragment", "voxels", "abstained", "by", "caption"):
            assert data[name] == [one[name] for one in frame.decisions], name
        for name in ("s_geo", "s_fea", "a", "threshold", "visibility"):
            assert [round(value * Q20) for value in data[name]] == [one[name] for one in frame.decisions], name
        expected = [(one["mask"], c) for one in frame.decisions for c in one["candidates"]]
        assert options["mask"] == [m for m, _ in expected]
        for name in ("instance", "overlap"):
            assert options[name] == [c[name] for _, c in expected]
        for name in ("s_geo", "s_fea", "a"):
            assert [round(value * Q20) for value in options[name]] == [c[name] for _, c in expected]


def test_the_graph_joins_masks_to_instances_by_what_speaks_for_them() -> None:
    step = Story().tell(
        instance_of={1: 1, 40: 40},
        masks=(mask(0, "a chair"), mask(1, "a lamp")),
        decisions=(decision(0, 1, "containment"), decision(1, 2, "new", candidates=())),
    )
    graph = decision_graph(step, {1: "chair", 2: "lamp", 40: "sofa"}.__getitem__)
    labels = dict(zip(graph.ids, graph.labels, strict=True))
    assert labels["m0-1"] == "containment: A 0.55, 9 of 20 voxels"
    assert labels["m0-40"] == "A 0.12, 2 of 20 voxels"
    assert labels["m1-2"] == "new"
    assert (labels["m0"], labels["i40"]) == ("mask 0: a chair", "40: sofa")
    assert graph.edges[:4] == [("m0", "m0-1"), ("m0-1", "i1"), ("m0", "m0-40"), ("m0-40", "i40")]
    assert len(set(graph.positions)) == len(graph.positions)  # no node hides another


def test_the_overlap_is_told_only_where_another_rule_than_the_threshold_decided() -> None:
    step = Story().tell(instance_of={1: 1}, masks=(mask(0, "a chair"),), decisions=(decision(0, 1, "threshold"),))
    assert decision_graph(step, str).labels[1] == "threshold: A 0.55"


def test_margins_are_the_least_of_the_frame() -> None:
    def candidates(*a: float) -> tuple[Candidate, ...]:
        return tuple(Candidate(i, 1, 0, 0, round(x * Q20)) for i, x in enumerate(a, 1))

    one = decision(0, 1, candidates=candidates(0.75, 0.5), threshold=Q20 // 2)
    two = decision(1, 1, candidates=candidates(0.375), threshold=Q20 // 2)
    none = decision(2, 2, "new", candidates=())
    masks = tuple(mask(n, "") for n in range(3))
    assert margins(Story().tell(instance_of={}, masks=masks, decisions=(one, two, none))) == (-0.125, 0.25)
    assert margins(Story().tell(instance_of={}, masks=masks, decisions=(none,))) is None


def states(path: Path, name: str) -> list[tuple[int, str]]:
    return [(row["frame"], row["state"][0]) for row in rows(path, f"lives/{name}")]


def test_each_life_is_told_as_states(tmp_path: Path) -> None:
    story = Story(tiny_frames(5))
    born = (Event(0, "new", 1, (), ""), Event(0, "new", 2, (), ""))
    story.tell(new=owned(box_of_voxels(0, 2), 1) | owned(box_of_voxels(3, 2), 2), instance_of={1: 1, 2: 2}, events=born)
    story.tell(instance_of={1: 1, 2: 2}, events=(Event(1, "confirmed", 1, (), ""),))
    story.tell(instance_of={1: 1, 2: 1}, events=(Event(2, "merged", 1, (2,), ""),))
    story.tell(instance_of={1: 1, 2: 2}, events=(Event(3, "split", 1, (2,), ""),))
    story.tell(instance_of={1: 1, 2: 2})
    dropped = (Event(4, "dropped", 2, (), "too small"),)
    end = finished([(0, 0, 0)], [1], captions={1: "white cup"})
    path = record(tmp_path / "run.rrd", story.steps, replace(end, events=dropped))
    assert states(path, "0001_white_cup") == [(0, "tentative"), (1, "confirmed")]
    fate = (3, "split, dropped at the end")  # the end has no width on a lane
    assert states(path, "0002") == [(0, "tentative"), (2, "merged"), fate, (4, "dropped")]


def test_every_state_on_a_lane_has_a_colour() -> None:
    assert {"split", "dropped", "split, dropped at the end"} < set(COLORS)


def test_a_lane_is_named_by_id_and_caption_in_letters_that_a_path_shows_as_they_are() -> None:
    assert lane(17, 'a "grün/white" cup, with a long, long handle') == "lives/0017_grün_white_cup"
    assert lane(5, "a close up of a green vegetable") == "lives/0005_green_vegetable"
    assert lane(2, "there is a low and very dark brown TV stand with doors") == "lives/0002_very_dark_brown_TV_stand"
    assert lane(4, "") == "lives/0004"


def test_a_merged_instance_keeps_the_caption_of_its_own_masks_in_its_lane(tmp_path: Path) -> None:
    story = Story(tiny_frames(2))
    masks, decisions = (mask(0, "cup"), mask(1, "lamp")), (decision(0, 1), decision(1, 2))
    story.tell(new=owned(box_of_voxels(0, 2), 1), instance_of={1: 1, 2: 2}, masks=masks, decisions=decisions)
    story.tell(instance_of={1: 1, 2: 1})
    path = record(tmp_path / "run.rrd", story.steps, None)
    assert states(path, "0002_lamp")[-1] == (1, "merged")


def test_each_mask_in_the_picture_has_its_number_caption_and_instance(tmp_path: Path) -> None:
    story = Story()
    masks = (mask(0, "there is a large red fire engine"), mask(1, "the lamp"))
    story.tell(instance_of={3: 3}, masks=masks, decisions=(decision(0, 3, "new"), decision(1, 0, "small")))
    (row,) = rows(record(tmp_path / "run.rrd", story.steps), "camera/names")
    assert row["labels"] == ["0: large red fir… → 3", "1: lamp → nothing"]
    (_, high), (_, low) = row["positions"]
    assert high == 8.0  # the larger one at the height of its middle
    assert abs(low - high) >= 6  # the other aside: its own middle is half a pixel higher


def test_where_no_place_is_free_a_mask_has_its_number_alone(tmp_path: Path) -> None:
    story = Story()
    masks = tuple(mask(0, "cup") for _ in range(5))
    story.tell(instance_of={3: 3}, masks=masks, decisions=tuple(decision(m, 3) for m in range(5)))
    (row,) = rows(record(tmp_path / "run.rrd", story.steps), "camera/names")
    assert row["labels"] == ["0: cup → 3", "1: cup → 3", "2", "3", "4"]  # one at the middle of all, one below
    assert row["positions"][3] == row["positions"][4] == [4.0, 8.0]


def test_the_best_views_of_an_instance_lie_beside_its_voxels_with_its_votes(tmp_path: Path) -> None:
    story = Story()
    story.tell(
        new=owned(box_of_voxels(0, 2), 1), instance_of={1: 1}, masks=(mask(1, "cup"),), decisions=(decision(0, 1),)
    )
    end = finished(box_of_voxels(0, 2), [1, 1], captions={1: "cup"})
    (row,) = rows(record(tmp_path / "run.rrd", story.steps, end), "world/instances/0001", static=True)
    assert row["votes"] == [f"cup ({end.instances[0].captions[0][1]:.4g})"]
    picture = cv2.imdecode(np.array(row["blob"][0], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (112, 112, 3)


def test_the_finished_map_is_drawn_in_the_order_of_the_drawings_before() -> None:
    live = LiveMap()
    story = Story(tiny_frames(2))
    live.apply(story.tell(new=owned([(5, 0, 0)], 1), instance_of={1: 1}))
    live.apply(story.tell(new=owned([(1, 0, 0), (9, 0, 0)], 1), instance_of={1: 1}))
    index = np.array([(1, 0, 0), (5, 0, 0), (9, 0, 0)], np.int32)
    assert (
        index[live.order_of(index)].tolist()
        == live.index_of(live.rows(1)).tolist()
        == [[5, 0, 0], [1, 0, 0], [9, 0, 0]]
    )


def test_only_every_nth_frame_shows_pictures_and_voxels_and_none_of_another_frame(tmp_path: Path) -> None:
    story = Story(tiny_frames(5))
    for n in range(5):
        story.tell(new=owned([(n, 0, 0)], 1), instance_of={1: 1}, masks=(mask(0, "box"),), decisions=(decision(0, 1),))
    path = record(tmp_path / "run.rrd", story.steps, None, every=3)
    color = [(row["frame"], bool(row.get("blob"))) for row in rows(path, "camera/detected/color")]
    assert color == [(0, True), (1, False), (3, True), (4, False)]
    masks = [(row["frame"], row.get("is_recursive")) for row in rows(path, "camera/detected/masks")]
    assert masks == [(0, None), (1, [False]), (3, None), (4, [False])]
    assert frames_of(path, "world/instances/0001") == [0, 3, 4]  # and what waited at the end
    assert frames_of(path, "decisions/data") == [0, 1, 2, 3, 4]


def test_frames_without_poses_leave_camera_and_pictures_out(tmp_path: Path) -> None:
    camera = Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0)
    story = Story([Frame(0, 5, Pose.identity(), Rig(camera, camera), np.zeros((1, 1), np.uint16))])
    story.tell(new=owned([(0, 0, 0)], 1), instance_of={1: 1})
    path = record(tmp_path / "run.rrd", story.steps, finished([(0, 0, 0)], [1]), camera=False)
    assert rows(path, "world/camera") == rows(path, "camera/rendered") == []
    assert frames_of(path, "world/instances/0001") == [0, 0]


def test_shares_and_entropies_by_hand() -> None:
    group = np.array([0, 0, 1, 1, 1, 2])
    instance = np.array([1, 2, 1, 1, 0, 3], np.int32)  # two fragments of instance 1 vote in voxel 1
    count = np.array([4, 4, 1, 2, 1, 5], np.int32)
    share, entropy = shares_and_entropies(group, instance, count, np.array([1, 1, 3, 0], np.int32))
    assert share.tolist() == [0.5, 0.75, 1.0, 0.0]
    assert entropy.tolist() == pytest.approx([1.0, 0.75 * np.log2(4 / 3) + 0.5, 0.0, 0.0])


def known(live: LiveMap) -> Mapping[str, Any]:
    every = np.arange(live.size)
    return {
        "index": live.index().tolist(),
        "instances": live.instances().tolist(),
        "shares": [numbers.tolist() for numbers in live.sureness(every)],
        "members": {i: live.rows(i).tolist() for i in live.populated()},
    }


def test_an_observer_of_a_resumed_run_knows_what_one_of_the_whole_run_knows() -> None:
    mapper, whole = Mapper(preset("openvox")), LiveMap()
    frames = tiny_frames(4)
    for frame in frames[:2]:
        whole.apply(mapper.step(frame, tuple(truth_masks(frame))))
    second, resumed = Mapper.resumed(mapper.finish(), preset("openvox")), LiveMap()
    for frame in frames[2:]:
        whole.apply(mapper.step(frame, tuple(truth_masks(frame))))
        resumed.apply(second.step(frame, tuple(truth_masks(frame))))
        assert known(resumed) == known(whole)
    result = mapper.finish()
    entropies = dict(zip(map(tuple, result.voxel_index.tolist()), finished_entropies(result).tolist(), strict=True))
    assert len(entropies) == whole.size


def test_the_table_of_instances_tells_votes_and_how_sure_the_voxels_are() -> None:
    row = Row(7, [("a chair", 3.0), ("a stool", 1.0)], 4, np.array([0, 0, 0, 0, 0, 1, 0, 0, 0, 8]))
    assert markdown([row]).splitlines()[-1] == "| 7 | 4 | 9 | `     ▁   █` | a chair (3); a stool (1) |"


def test_the_views_of_each_instance_lie_side_by_side_in_one_sheet() -> None:
    views = BestViews()
    for frame in tiny_frames(2):
        story = Story([frame])
        masks = (mask(frame.index, "box"), mask(2, "ball"))
        views.add(story.tell(instance_of={5: 3, 6: 6}, masks=masks, decisions=(decision(0, 5), decision(1, 6))))
    strips = views.strips([3, 6, 9], {5: 3, 6: 6}.__getitem__)
    assert {instance: strip.shape for instance, strip in strips.items()} == {3: (112, 112, 3), 6: (112, 112, 3)}
    together = sheet(strips)
    assert together.boxes == {3: (0, 0, 336, 112), 6: (346, 0, 336, 112)}  # side by side; 9 was never seen
    assert together.picture.shape == (122, WIDTH, 3)


def test_voxel_size_is_that_of_the_run(tmp_path: Path) -> None:
    story = Story()
    story.tell(new=owned([(0, 0, 0)], 1), instance_of={1: 1})
    row = rows(record(tmp_path / "run.rrd", story.steps), "world/instances/0001")[0]
    assert row["voxel_size"] == [pytest.approx([SIZE] * 3)]


def test_of_near_frames_the_larger_mask_is_the_better_view() -> None:
    views = BestViews()
    for frame, number in zip(tiny_frames(3), (3, 1, 0), strict=True):  # the border cuts mask 0
        views.add(Story([frame]).tell(instance_of={5: 5}, masks=(mask(number, ""),), decisions=(decision(0, 5),)))
    assert [view.frame for view in views.of(5)] == [1]
