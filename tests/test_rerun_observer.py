"""What a run looks like in Rerun: everything is there, only what changed is logged, and the end is the map."""

from __future__ import annotations

import os
import subprocess
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from maps import labelled_map
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from worlds import tiny_frames

from openvox.core.colors import instance_color
from openvox.core.digest import map_digest
from openvox.core.errors import OutputError
from openvox.core.fixedpoint import Q20
from openvox.core.mapper_parameters import preset
from openvox.core.parameters import updated
from openvox.core.types import (
    Candidate,
    Decision,
    Event,
    Frame,
    InstanceMap,
    Mask,
    Pose,
    Rig,
    Step,
    VoxelChanges,
)
from openvox.mapper.mapper import Mapper
from openvox.view.decision_table import markdown
from openvox.view.entities import confidence_path, instance_path
from openvox.view.live_map import LiveMap
from openvox.view.redraw import PATIENCE
from openvox.view.rerun_observer import RerunObserver

SIZE = 0.05
VOTES = 8
FRAMES = tiny_frames(4)


@pytest.fixture(autouse=True)
def strict() -> Iterator[None]:
    """What Rerun would only warn of is an error here."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


class Story:
    """Steps made by hand: what each frame does to the voxels."""

    def __init__(self, frames: Sequence[Frame] = FRAMES) -> None:
        self.frames = list(frames)
        self.index = np.zeros((0, 3), np.int32)
        self.steps: list[Step] = []
        self.votes: dict[tuple[int, int], int] = {}

    def tell(
        self,
        *,
        new: Mapping[tuple[int, int, int], int] | None = None,
        changed: Mapping[int, int] | None = None,
        instance_of: Mapping[int, int],
        share: float = 0.5,
        **step: Any,
    ) -> Step:
        """new: index of each new voxel to its owner; changed: number of each old voxel to its owner now."""
        first, added = len(self.index), sorted(new or {})
        index = np.array(added, np.int32).reshape(-1, 3)
        owners = {**(changed or {}), **{first + i: (new or {})[voxel] for i, voxel in enumerate(added)}}
        self.index = np.concatenate([self.index, index])
        won = round(share * VOTES)
        votes = dict.fromkeys(owners.items(), won)
        votes |= {(voxel, 0): VOTES if not owner else VOTES - won for voxel, owner in owners.items()}
        votes |= {pair: 0 for pair in self.votes if pair[0] in owners and pair not in votes}
        self.votes |= votes
        pairs = np.array(sorted(votes), np.int32).reshape(-1, 2)
        changes = VoxelChanges(
            first_new=first,
            new_index=index,
            voxel=pairs[:, 0],
            fragment=pairs[:, 1],
            count=np.array([votes[pair] for pair in sorted(votes)], np.int32),
            touched=np.array(sorted(owners), np.int32),
            owner=np.array([owners[number] for number in sorted(owners)], np.int32),
            share=np.full(len(owners), round(share * Q20), np.int32),
        )
        fields = {"masks": (), "looked": True, "decisions": (), "events": ()} | step
        frame = self.frames[len(self.steps)]
        told = Step(frame=frame, changes=changes, instance_of=instance_of, voxels=len(self.index), **fields)
        self.steps.append(told)
        return told


def box_of_voxels(x: int, n: int) -> list[tuple[int, int, int]]:
    return [(x, i, 0) for i in range(n)]


def owned(voxels: Sequence[tuple[int, int, int]], owner: int) -> dict[tuple[int, int, int], int]:
    return dict.fromkeys(voxels, owner)


def mask(number: int, caption: str) -> Mask:
    bitmap = np.zeros((24, 32), np.bool_)
    bitmap[4 : 12 - number, 4 * number : 4 * number + 8] = True
    return Mask.from_bitmap(bitmap, caption=caption)


def decision(number: int, instance: int, by: str = "threshold", **changes: Any) -> Decision:
    fields: dict[str, Any] = {
        "held": (instance,),
        "voxels": 20,
        "abstained": 1,
        "s_geo": round(0.75 * Q20),
        "s_fea": round(-0.25 * Q20),
        "a": round(0.55 * Q20),
        "threshold": round(0.4 * Q20),
        "visibility": round(0.5 * Q20),
        "credibility": 3 << 11,
        "candidates": (Candidate(instance, 9, 1, 2, round(0.55 * Q20)), Candidate(40, 2, 1, 2, round(0.125 * Q20))),
    }
    return Decision(mask=number, by=by, instance=instance, fragment=instance, **{**fields, **changes})


def finished(index: Sequence[tuple[int, int, int]], label: Sequence[int], **more: Any) -> InstanceMap:
    order = sorted(range(len(index)), key=lambda i: index[i])
    return labelled_map(
        np.array([index[i] for i in order], np.int32).reshape(-1, 3),
        np.array([label[i] for i in order], np.int32),
        voxel_size=SIZE,
        **more,
    )


NOTHING = finished([(0, 0, 0)], [0])


def record(path: Path, steps: Sequence[Step], result: InstanceMap | None = NOTHING, **options: Any) -> Path:
    with RerunObserver(path, voxel_size=SIZE, **options) as observer:
        for step in steps:
            observer.on_step(step)
        observer.close(result)
    return path


def rows(path: Path, entity: str, *, static: bool = False) -> list[dict[str, Any]]:
    """What was logged to an entity over time (or for all time), in order: timelines and components by their names."""
    found = []
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == f"/{entity}" and ("frame" in batch.schema.names) != static:
            columns = {
                name.split(":")[-1]: batch.column(name).cast(pa.int64())
                if name == "sensor_time"
                else batch.column(name)
                for name in batch.schema.names
            }
            for i in range(batch.num_rows):
                found.append({name: column[i].as_py() for name, column in columns.items()})
    return sorted(found, key=lambda row: bytes(row["rerun.controls.RowId"]))


def frames_of(path: Path, entity: str) -> list[int]:
    return [row["frame"] for row in rows(path, entity)]


def voxels_of(row: Mapping[str, Any]) -> list[tuple[int, int, int]]:
    return sorted(tuple(index) for index in row["voxel_indices"])


# ---- all there -------------------------------------------------------------------------------------------------------


def test_every_frame_is_there_on_both_timelines(tmp_path: Path) -> None:
    story = Story()
    for n in range(3):
        story.tell(new=owned([(0, 0, n)], 1), instance_of={1: 1}, masks=(mask(0, "box"),), decisions=(decision(0, 1),))
    path = record(tmp_path / "run.rrd", story.steps)
    times = [(frame.index, frame.stamp_ns) for frame in FRAMES[:3]]
    for entity in (
        "camera/detected/color",
        "camera/detected/masks",
        "decisions/table",
        "decisions/data",
        "stats/voxels",
    ):
        assert [(row["frame"], row["sensor_time"]) for row in rows(path, entity)] == times, entity
    pictures = [bytes(row["blob"][0]) for row in rows(path, "camera/detected/color")]
    assert pictures == [frame.color for frame in FRAMES[:3]]
    assert [row["scalars"] for row in rows(path, "stats/voxels")] == [[1.0], [2.0], [3.0]]
    assert [row["scalars"] for row in rows(path, "stats/instances")] == [[1.0], [1.0], [1.0]]


def test_the_camera_stands_where_the_colour_camera_stood_and_its_lens_is_logged_once(tmp_path: Path) -> None:
    aside = Pose((0.0, 0.0, 0.0, 1.0), (0.1, 0.2, 0.3))
    upright = Pose.identity()
    frames = [
        replace(frame, rig=Rig(frame.rig.depth, frame.rig.color, aside), world_from_depth=upright) for frame in FRAMES
    ]
    story = Story(frames)
    story.tell(instance_of={})
    story.tell(instance_of={})
    logged = rows(record(tmp_path / "run.rrd", story.steps), "world/camera")
    assert [row["translation"] for row in logged if row.get("translation")] == [[pytest.approx([0.1, 0.2, 0.3])]] * 2
    assert [row["resolution"] for row in logged if row.get("resolution")] == [[[32.0, 24.0]]]


def test_masks_are_numbered_by_mask_smaller_ones_on_top_in_the_colour_of_their_instance(tmp_path: Path) -> None:
    story = Story()
    masks = (mask(0, "a large box"), mask(1, "a small box"))
    story.tell(instance_of={3: 3}, masks=masks, decisions=(decision(0, 3, "new"), decision(1, 0, "small")))
    (row,) = rows(record(tmp_path / "run.rrd", story.steps), "camera/detected/masks")[-1:]
    image = np.array(row["buffer"][0], np.uint8).reshape(24, 32)
    assert image[5, 0] == 1
    assert image[5, 4] == 2  # both masks are here
    assert image[20, 20] == 0
    infos = {info["class_id"]: info["class_description"]["info"] for info in row["context"][0]}
    assert infos[1]["label"] == "mask 0: a large box → 3"
    assert infos[2]["label"] == "mask 1: a small box → nothing"
    red, green, blue = instance_color(3)
    assert infos[1]["color"] == red << 24 | green << 16 | blue << 8 | 255


def test_the_map_is_drawn_from_the_pose_of_the_colour_camera(tmp_path: Path) -> None:
    story = Story([replace(frame, world_from_depth=Pose.identity()) for frame in FRAMES])
    story.tell(
        new={(0, 0, 20): 7, (-1, 0, 20): 0}, instance_of={7: 7}
    )  # a metre before it, right and left of the middle
    (row,) = rows(record(tmp_path / "run.rrd", story.steps, finished([(0, 0, 20)], [7])), "camera/rendered")[:1]
    image = np.array(row["buffer"][0], np.uint8).reshape(24, 32)
    names = {info["class_id"]: info["class_description"]["info"]["label"] for info in row["context"][0]}
    assert (names[image[12, 16]], names[image[12, 15]]) == ("7: ", "background")
    assert image[0, 0] == 0


def test_a_frame_without_colour_still_has_its_masks(tmp_path: Path) -> None:
    story = Story(tiny_frames(1, color_format=""))
    story.tell(instance_of={1: 1}, masks=(mask(0, "box"),), decisions=(decision(0, 1),))
    path = record(tmp_path / "run.rrd", story.steps)
    assert rows(path, "camera/detected/color") == []
    assert frames_of(path, "camera/detected/masks") == [0]


def test_without_images_no_picture_is_logged(tmp_path: Path) -> None:
    story = Story()
    story.tell(instance_of={1: 1}, masks=(mask(0, "box"),), decisions=(decision(0, 1),))
    path = record(tmp_path / "run.rrd", story.steps, images="none")
    assert [rows(path, f"camera/{name}") for name in ("detected/color", "detected/masks", "rendered")] == [[], [], []]
    assert frames_of(path, "decisions/table") == [0]


def test_events_are_a_log_in_words(tmp_path: Path) -> None:
    story = Story()
    born = Event(0, "new", 1, (), "mask 0 holds nothing that the map knows")
    story.tell(instance_of={1: 1}, masks=(mask(0, "a box"),), decisions=(decision(0, 1, "new"),), events=(born,))
    story.tell(instance_of={1: 1, 2: 1}, events=(Event(1, "merged", 1, (2,), "seen together"),))
    logged = rows(record(tmp_path / "run.rrd", story.steps), "events")
    assert [(row["frame"], row["level"], row["text"]) for row in logged] == [
        (0, ["INFO"], ["new 1 (a box): mask 0 holds nothing that the map knows"]),
        (1, ["WARN"], ["merged 1 (a box) with 2: seen together"]),
    ]


def test_the_layout_travels_in_the_file(tmp_path: Path) -> None:
    reader = RrdReader(str(record(tmp_path / "run.rrd", [])))
    assert [entry.application_id for entry in reader.recordings()] == ["openvox"]
    assert {entry.application_id for entry in reader.blueprints()} == {"openvox"}


# ---- decisions -------------------------------------------------------------------------------------------------------


def test_the_table_and_its_data_are_the_decisions(tmp_path: Path) -> None:
    story = Story()
    new = decision(1, 2, "new", s_geo=0, s_fea=0, a=0, candidates=(), credibility=4096, visibility=Q20)
    masks = (mask(0, "a grey chair"), mask(1, "a lamp"))
    story.tell(instance_of={1: 1, 2: 2}, masks=masks, decisions=(decision(0, 1), new))
    path = record(tmp_path / "run.rrd", story.steps)
    table = rows(path, "decisions/table")[0]["text"][0].splitlines()
    assert (
        table[4] == r"| 0 | a grey chair | **1** | threshold | 0.55 / 0.40 | 0.75 | -0.25 | 40 (0.12) | 0.50 | 1.50 |"
    )
    assert table[5] == r"| 1 | a lamp | **2** | new | - / 0.40 | - | - | - | 1.00 | 1.00 |"
    (data,) = rows(path, "decisions/data")
    for name in ("mask", "instance", "fragment", "voxels", "abstained", "by"):
        assert data[name] == [getattr(one, name) for one in (decision(0, 1), new)], name
    for name in ("s_geo", "s_fea", "a", "threshold", "visibility"):
        assert data[name] == [getattr(one, name) / Q20 for one in (decision(0, 1), new)], name
    assert data["credibility"] == [1.5, 1.0]
    assert data["caption"] == ["a grey chair", "a lamp"]


def test_a_frame_at_which_perception_did_not_look_says_so(tmp_path: Path) -> None:
    story = Story()
    story.tell(instance_of={}, looked=False)
    story.tell(instance_of={})
    path = record(tmp_path / "run.rrd", story.steps)
    texts = [row["text"][0] for row in rows(path, "decisions/table")]
    assert "did not look" in texts[0]
    assert "found no mask" in texts[1]
    assert [row["mask"] for row in rows(path, "decisions/data")] == [[], []]


def test_captions_cannot_break_the_table() -> None:
    story = Story()
    step = story.tell(instance_of={1: 1}, masks=(mask(0, "a|b\n*c* <i>"),), decisions=(decision(0, 1),))
    row = markdown(step).splitlines()[4]
    assert row.startswith(r"| 0 | a\|b \*c\* \<i\> | **1** |")


# ---- voxels ----------------------------------------------------------------------------------------------------------


def test_only_what_changed_is_drawn_again(tmp_path: Path) -> None:
    story = Story()
    both = {1: 1, 2: 2}
    story.tell(new=owned(box_of_voxels(0, 4), 1) | owned(box_of_voxels(5, 4), 2), instance_of=both)
    story.tell(changed={0: 1}, share=0.75, instance_of=both)  # surer, but the same voxels
    story.tell(new=owned(box_of_voxels(6, 2), 2), instance_of=both)
    path = record(tmp_path / "run.rrd", story.steps, finished(box_of_voxels(0, 4), [1] * 4))
    assert frames_of(path, instance_path(1)) == [0, 2]  # at its birth and at the end
    assert frames_of(path, instance_path(2)) == [0, 2, 2]
    assert voxels_of(rows(path, instance_path(2))[1]) == box_of_voxels(5, 4) + box_of_voxels(6, 2)


def test_a_small_change_is_drawn_after_a_while(tmp_path: Path) -> None:
    story = Story(tiny_frames(PATIENCE + 3))
    one = {1: 1}
    story.tell(new=owned(box_of_voxels(0, 40), 1), instance_of=one)
    story.tell(new=owned([(1, 0, 0)], 1), instance_of=one)
    for _ in range(PATIENCE + 1):
        story.tell(instance_of=one)
    path = record(tmp_path / "run.rrd", story.steps, finished(box_of_voxels(0, 4), [1] * 4), images="none")
    assert frames_of(path, instance_path(1)) == [0, 1 + PATIENCE, PATIENCE + 2]
    assert len(rows(path, instance_path(1))[1]["voxel_indices"]) == 41


def test_a_merged_instance_is_cleared_and_its_voxels_go_to_the_other_at_once(tmp_path: Path) -> None:
    story = Story()
    story.tell(new=owned(box_of_voxels(0, 40), 1) | owned([(5, 0, 0)], 2), instance_of={1: 1, 2: 2})
    story.tell(instance_of={1: 1, 2: 1})
    story.tell(instance_of={1: 1, 2: 2})
    path = record(tmp_path / "run.rrd", story.steps, finished([(0, 0, 0)], [1]))
    first, merged, parted, last = rows(path, instance_path(1))
    assert [row["frame"] for row in (first, merged, parted, last)] == [0, 1, 2, 2]
    assert voxels_of(merged) == sorted([*box_of_voxels(0, 40), (5, 0, 0)])
    assert voxels_of(parted) == voxels_of(first) == box_of_voxels(0, 40)
    alone, cleared, again, dropped = rows(path, instance_path(2))
    assert [row["frame"] for row in (alone, cleared, again, dropped)] == [0, 1, 2, 2]
    assert voxels_of(cleared) == voxels_of(dropped) == []
    assert voxels_of(again) == [(5, 0, 0)]


def test_the_end_is_the_finished_map_with_its_confidences(tmp_path: Path) -> None:
    story = Story()
    story.tell(new=owned(box_of_voxels(0, 3), 1) | owned(box_of_voxels(5, 3), 2), instance_of={1: 1, 2: 2})
    result = finished(
        [*box_of_voxels(0, 3), *box_of_voxels(5, 3)],
        [1, 1, 0, 0, 0, 0],
        voxel_confidence=0.625,
        captions={1: "a chair"},
    )
    path = record(tmp_path / "run.rrd", story.steps, result)
    end = rows(path, instance_path(1))[-1]
    assert voxels_of(end) == [(0, 0, 0), (0, 1, 0)]
    assert (end["instance"], end["caption"], end["voxel_size"]) == ([1], ["a chair"], [pytest.approx([SIZE] * 3)])
    red, green, blue = instance_color(1)
    assert end["colors"] == [red << 24 | green << 16 | blue << 8 | 255]
    (confidence,) = rows(path, confidence_path(1), static=True)
    assert (voxels_of(confidence), confidence["values"]) == (voxels_of(end), [0.625, 0.625])
    assert voxels_of(rows(path, instance_path(2))[-1]) == []


def test_confidences_are_those_of_the_end_at_every_frame(tmp_path: Path) -> None:
    story = Story()
    both = {1: 1, 2: 2}
    story.tell(new=owned(box_of_voxels(0, 2), 1) | owned(box_of_voxels(5, 2), 2), instance_of=both, share=0.5)
    story.tell(changed={0: 1}, instance_of=both, share=0.75)
    path = record(tmp_path / "run.rrd", story.steps, None)
    assert not rows(path, confidence_path(1))
    (only,) = rows(path, confidence_path(1), static=True)
    assert only["values"] == [0.5, 0.75]  # equal ones side by side
    assert only["voxel_indices"] == [[0, 1, 0], [0, 0, 0]]


# ---- the observer's copy of the map ----------------------------------------------------------------------------------


def random_story(n: int, seed: int) -> Story:
    random = np.random.default_rng(seed)
    story = Story(tiny_frames(n))
    for t in range(n):
        known = len(story.index)
        fragments = 2 + t // 2
        new = {(t, int(y), 0): int(random.integers(0, fragments)) for y in random.integers(0, 9, 5)}
        changed = {int(v): int(random.integers(0, fragments)) for v in random.integers(0, known, min(known, 6))}
        instance_of = {f: int(random.integers(1, f + 1)) for f in range(1, fragments)}
        story.tell(new=new, changed=changed, instance_of=instance_of, share=float(random.integers(1, 5)) / 4)
    return story


@pytest.mark.parametrize("seed", range(5))
def test_the_observers_copy_agrees_with_a_slow_and_obvious_one(seed: int) -> None:
    live, owner, instances = LiveMap(), dict[int, int](), dict[int, int]()
    for step in random_story(15, seed).steps:
        change = live.apply(step)
        before = instances
        owner |= dict(zip(step.changes.touched.tolist(), step.changes.owner.tolist(), strict=True))
        instances = {voxel: step.instance_of.get(fragment, 0) for voxel, fragment in owner.items()}
        assert live.instances().tolist() == [instances[voxel] for voxel in range(len(owner))]
        alive = sorted({instance for instance in instances.values() if instance})
        assert live.populated() == alive
        for instance in alive:
            assert live.rows(instance).tolist() == sorted(v for v in instances if instances[v] == instance)
        assert change.moved == Counter(
            i for v in instances if (old := before.get(v, 0)) != instances[v] for i in (old, instances[v])
        )
        assert set(change.touched) >= {instances[v] for v in step.changes.touched.tolist()}


# ---- files -----------------------------------------------------------------------------------------------------------


def rerun_says_equal(a: Path, b: Path) -> bool:
    import rerun_cli

    program = os.path.join(os.path.dirname(rerun_cli.__file__), "rerun")
    found = subprocess.run([program, "rrd", "compare", "--unordered", str(a), str(b)], capture_output=True, check=False)
    return found.returncode == 0


def test_equal_runs_give_equal_recordings(tmp_path: Path) -> None:
    story = random_story(6, seed=3)
    for folder in ("a", "b", "c"):
        (tmp_path / folder).mkdir()
    a, b = (record(tmp_path / folder / "run.rrd", story.steps) for folder in ("a", "b"))
    other = record(tmp_path / "c" / "run.rrd", story.steps[:-1])
    assert rerun_says_equal(a, b)
    assert not rerun_says_equal(a, other)


def test_the_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"older")
    story = Story()
    with RerunObserver(path, voxel_size=SIZE) as observer:
        observer.on_step(story.tell(instance_of={}))
        assert path.read_bytes() == b"older"
        observer.close(NOTHING)
    assert [file.name for file in tmp_path.iterdir()] == ["run.rrd"]
    assert len(path.read_bytes()) > 1000


def test_an_interrupted_run_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"older")

    def run() -> None:
        with RerunObserver(path, voxel_size=SIZE) as observer:
            observer.on_step(Story().tell(instance_of={}))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run()
    assert [file.name for file in tmp_path.iterdir()] == ["run.rrd"]
    assert path.read_bytes() == b"older"


def test_a_place_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"missing/run\.rrd could not be written"):
        RerunObserver(tmp_path / "missing" / "run.rrd", voxel_size=SIZE)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("no /dev/full on this system")
    (tmp_path / "run.rrd.partial").symlink_to(full)
    with pytest.raises(OutputError, match=r"run\.rrd could not be written .*disk"):
        record(tmp_path / "run.rrd", [Story().tell(instance_of={})])
    assert list(tmp_path.iterdir()) == []


def test_watching_does_not_change_the_map(tmp_path: Path) -> None:
    frames = tiny_frames(4)
    masks: list[tuple[Mask, ...]] = [tuple(truth_masks(frame)) for frame in frames]
    parameters = updated(preset("openvox"), {"masks.step_margin": 0}, source="test")  # else so few pixels hold nothing
    watched, alone = Mapper(parameters), Mapper(parameters)
    with RerunObserver(tmp_path / "run.rrd", voxel_size=0.04) as observer:
        for frame, found in zip(frames, masks, strict=True):
            observer.on_step(watched.step(frame, found))
            alone.step(frame, found)
        result = watched.finish()
        observer.close(result)
    assert map_digest(result) == map_digest(alone.finish())
    assert 1 in result.instance_id
    assert {tuple(v) for v in result.voxel_index[result.voxel_instance == 1].tolist()} == set(
        voxels_of(rows(tmp_path / "run.rrd", instance_path(1))[-1])
    )


def truth_masks(frame: Frame) -> Iterator[Mask]:
    assert frame.truth_instances is not None
    ids: NDArray[np.uint16] = frame.truth_instances
    for instance in np.unique(ids[ids > 0]).tolist():
        yield Mask.from_bitmap(ids == instance, caption=f"thing {instance}")


def test_a_writer_that_stops_amid_the_run_is_one_sentence_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*arguments: object, **options: object) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    step = Mapper(preset("paper")).step(tiny_frames(1)[0], ())
    with RerunObserver(tmp_path / "run.rrd", voxel_size=0.04) as observer:
        monkeypatch.setattr(rr.RecordingStream, "log", stopped)
        with pytest.raises(OutputError, match=r"run\.rrd could not be written \(Rerun's writer stopped: File-writer"):
            observer.on_step(step)
    assert list(tmp_path.iterdir()) == []
