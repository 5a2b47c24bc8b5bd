"""evaluate: what is read as truth, what each measure counts, and what is null where the truth has nothing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maps import META, labelled_map
from numpy.typing import NDArray
from worlds import BOXES, CAMERA, CATEGORIES, tiny_frames, write_scannet

from openvox.apps.evaluate import evaluate
from openvox.apps.scoring.calibration import expected_calibration_error
from openvox.apps.scoring.instances import Overlaps
from openvox.apps.scoring.recording_truth import recording_truth
from openvox.apps.scoring.rendered import score_rendered
from openvox.apps.scoring.seen import filled
from openvox.apps.scoring.semantics import class_means, read_classes, recalls, retrieve, score_semantics
from openvox.apps.scoring.truth_images import truth_images
from openvox.core.errors import InputError
from openvox.core.types import Frame, InstanceMap, Intrinsics, Mask, Pose, Rig
from openvox.formats.map_npz import write_map
from openvox.formats.perception import FrameMasks, PerceptionWriter, perception_info
from openvox.formats.recording import RecordingWriter, recording_info
from openvox.formats.truth import Query, Truth, read_truth

# ---- truth in a folder


def truth_folder(tmp_path: Path, **changes: Any) -> Path:
    """Two objects (a lamp of category 3, a mug of 5) and background (category 1), twenty points each."""
    folder = tmp_path / "truth"
    folder.mkdir()
    arrays = {
        "points": np.arange(180, dtype=np.float32).reshape(60, 3) / 100,
        "instance": np.repeat([0, 4, 9], 20).astype(np.int32),
        "category": np.repeat([1, 3, 5], 20).astype(np.int32),
    }
    texts = {
        "objects.json": {
            "categories": {"mug": 5, "wall": 1, "desk_lamp": 3},
            "objects": [{"id": 9, "name": "mug"}, {"id": 4, "name": "lamp"}],
        },
        "queries.json": {"queries": [{"type": "ontology", "text": "a lamp", "instances": [9, 4]}]},
    }
    np.savez(
        folder / "gt_points.npz", **{n: changes.get(n, a) for n, a in arrays.items() if changes.get(n, a) is not None}
    )
    for name, content in texts.items():
        given = changes.get(name, content)
        if given is not None:
            (folder / name).write_text(given if isinstance(given, str) else json.dumps(given))
    return folder


def test_a_folder_of_truth_is_read(tmp_path: Path) -> None:
    truth = read_truth(truth_folder(tmp_path))
    assert (truth.points.shape, truth.points.dtype) == ((60, 3), np.float64)
    assert np.unique(truth.instance).tolist() == [0, 4, 9]
    assert [(o.id, o.name) for o in truth.objects] == [(4, "lamp"), (9, "mug")]
    assert list(truth.categories.items()) == [(1, "wall"), (3, "desk_lamp"), (5, "mug")]
    assert truth.queries == (Query("a lamp", "ontology", (4, 9)),)


def test_points_alone_are_truth_enough(tmp_path: Path) -> None:
    truth = read_truth(truth_folder(tmp_path, category=None, **{"objects.json": None, "queries.json": None}))
    assert (truth.category, truth.objects, truth.queries, truth.categories) == (None, (), (), {})


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"points": None}, r"has no array points"),
        ({"points": np.zeros((60, 2))}, r"points has shape \(60, 2\); expected 3 in place of 2"),
        ({"points": np.full((60, 3), np.nan)}, r"a point is not finite"),
        ({"points": np.full((60, 3), 1e7)}, r"farther than 1e\+06 m"),
        ({"points": np.zeros((0, 3)), "instance": np.zeros(0, int), "category": None}, r"has no points"),
        ({"instance": np.zeros(59, int)}, r"instance has shape \(59,\); expected 60"),
        ({"instance": np.full(60, -1)}, r"instance holds int64; expected whole numbers from 0"),
        ({"instance": np.zeros(60)}, r"instance holds float64; expected whole numbers"),
        ({"category": np.zeros(3, int)}, r"category has shape \(3,\); expected 60"),
        ({"objects.json": "{"}, r"objects.json is no JSON"),
        ({"objects.json": "[" * 100_000}, r"objects.json is no JSON"),
        ({"objects.json": []}, r"objects.json holds list; expected a JSON object"),
        ({"objects.json": {"objects": {}}}, r'expected "objects", a list'),
        ({"objects.json": {"objects": [{"id": 0, "name": "x"}]}}, r"object 0 has no id of its own"),
        ({"objects.json": {"objects": [{"id": 3, "name": "x"}] * 2}}, r"object 1 has no id of its own"),
        ({"objects.json": {"objects": [{"id": 3, "name": " "}]}}, r"object 0 has \"name\" ' '; expected a text"),
        ({"objects.json": {"categories": {"x": "1"}}}, r"category 'x' has number '1'; expected one of its own"),
        ({"objects.json": {"categories": {"x": 1, "y": 1}}}, r"category 'y' has number 1; expected one of its own"),
        ({"queries.json": {}}, r'has no list "queries"'),
        ({"queries.json": {"queries": [3]}}, r'query 0 has "instances" None'),
        ({"queries.json": {"queries": [{"text": "a", "type": "b", "instances": []}]}}, r'query 0 has "instances" \[\]'),
        ({"queries.json": {"queries": [{"type": "b", "instances": [1]}]}}, r'query 0 has "text" None'),
    ],
)
def test_wrong_truth_is_one_sentence(tmp_path: Path, changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        read_truth(truth_folder(tmp_path, **changes))


def test_a_folder_without_points_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no gt_points.npz; expected points .* or name a recording with truth"):
        read_truth(tmp_path)
    with pytest.raises(InputError, match=r"other.json cannot be read"):
        read_truth(truth_folder(tmp_path), tmp_path / "other.json")


def test_classes_are_lines(tmp_path: Path) -> None:
    path = tmp_path / "classes.txt"
    path.write_text("desk lamp\n\n  mug \n")
    assert read_classes(path) == ("desk lamp", "mug")
    for content, sentence in (
        (b"\n", "names no class"),
        (b"a_b\nA b\n", "names the class 'A b' twice"),
        (b"\xff", "no text"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=sentence):
            read_classes(path)


# ---- truth out of a recording


def record(path: Path, frames: Sequence[Frame], categories: dict[int, str] | None = None) -> Path:
    with RecordingWriter(path, source="test", categories=CATEGORIES if categories is None else categories) as writer:
        for frame in frames:
            writer.add(frame)
    return path


def naive_truth(frames: Sequence[Frame]) -> dict[tuple[int, ...], tuple[list[float], int]]:
    """Point and category of each (cell, instance), the first one, pixel by pixel."""
    found: dict[tuple[int, ...], tuple[list[float], int]] = {}
    for frame in frames:
        assert frame.truth_instances is not None
        assert frame.truth_categories is not None
        into_color = np.linalg.inv(frame.rig.depth_from_color.matrix())
        d, c = frame.rig.depth, frame.rig.color
        for v, u in np.argwhere(frame.depth).tolist():
            z = frame.depth[v, u] / 1000
            local = np.array([(u - d.cx) / d.fx * z, (v - d.cy) / d.fy * z, z, 1.0])
            x, y, forward, _ = into_color @ local
            column, row = int(np.floor(x / forward * c.fx + c.cx + 0.5)), int(np.floor(y / forward * c.fy + c.cy + 0.5))
            if not (0 <= column < c.width and 0 <= row < c.height):
                continue
            point = (frame.world_from_depth.matrix() @ local)[:3]
            key = (*np.floor(point / 0.02).astype(int).tolist(), int(frame.truth_instances[row, column]))
            found.setdefault(key, (point.round(3).tolist(), int(frame.truth_categories[row, column])))
    return found


def two_cameras(frame: Frame) -> Frame:
    """The same pictures, said to be of a colour camera 5 cm to the right with a longer lens."""
    color = Intrinsics(CAMERA.width, CAMERA.height, 29.0, 29.0, 15.5, 11.5)
    return replace(frame, rig=Rig(CAMERA, color, Pose((0.0, 0.0, 0.0, 1.0), (0.05, 0.0, 0.0))))


@pytest.mark.parametrize("cameras", ["one", "two"])
def test_a_recordings_points_are_the_first_in_their_cell_and_instance(tmp_path: Path, cameras: str) -> None:
    frames = [two_cameras(frame) if cameras == "two" else frame for frame in tiny_frames(4)]
    truth = recording_truth(record(tmp_path / "a.mcap", frames), None)
    expected = naive_truth(frames)
    assert truth.category is not None
    assert len(expected) > 500
    assert truth.instance.tolist() == [key[3] for key in expected]
    assert truth.category.tolist() == [category for _, category in expected.values()]
    assert truth.points == pytest.approx(np.array([point for point, _ in expected.values()]), abs=1e-9)
    assert [(o.id, o.name) for o in truth.objects] == [(1, "table 1"), (2, "box 2"), (3, "box 3")]
    assert dict(truth.categories) == CATEGORIES


def test_a_recording_without_truth_or_too_wide_a_world_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has no ground truth; name a folder with gt_points.npz"):
        recording_truth(record(tmp_path / "a.mcap", tiny_frames(2, truth=False)), None)
    frame, other = tiny_frames(2)
    far = replace(other, world_from_depth=Pose(other.world_from_depth.quaternion, (700.0, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"frame 1 sees a point more than 655 m from where the first one was taken"):
        recording_truth(record(tmp_path / "b.mcap", [frame, far]), None)
    with pytest.raises(InputError, match="has no depth under its truth pictures"):
        recording_truth(record(tmp_path / "c.mcap", [replace(frame, depth=np.zeros_like(frame.depth))]), None)


# ---- confidence


def test_calibration_is_the_gap_between_confidence_and_share_of_right_points() -> None:
    truth = np.array([1] * 8 + [2] * 2 + [0] * 5)
    labels = np.array([7] * 8 + [7] * 2 + [0] * 5)
    # instance 7 has most of its points on object 1: eight of ten are right, at confidence 0.7
    assert expected_calibration_error(truth, labels, np.full(15, 0.7)) == pytest.approx(0.1)
    # right ones at 0.95 (upper bin: gap 0.05 over 8 points), wrong ones at 0.25 (gap 0.25 over 2 points)
    confidence = np.array([0.95] * 8 + [0.25] * 2 + [0.5] * 5)
    assert expected_calibration_error(truth, labels, confidence) == pytest.approx((8 * 0.05 + 2 * 0.25) / 10)


def test_on_an_edge_of_two_bins_the_upper_one_counts_and_certainty_is_in_the_last() -> None:
    truth, labels = np.array([1, 1, 1, 2]), np.array([7, 7, 7, 7])
    # 1.0 shares the bin of 0.95: one right of two against a mean of 0.975; the two at 0.5 are right
    confidence = np.array([0.5, 0.5, 0.95, 1.0])
    assert expected_calibration_error(truth, labels, confidence) == pytest.approx((2 * 0.5 + 2 * (0.975 - 0.5)) / 4)


def test_an_instance_on_background_is_never_right_and_without_labels_there_is_nothing_to_measure() -> None:
    assert expected_calibration_error(np.zeros(4, int), np.ones(4, int), np.full(4, 0.75)) == pytest.approx(0.75)
    assert expected_calibration_error(np.ones(4, int), np.zeros(4, int), np.ones(4)) is None


# ---- words


class Letters:
    """Puts a text on the axis of its first letter: a, b, c, everything else."""

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        axes = [min("abc".find(text[0]) % 5, 3) for text in texts]
        return np.eye(4, dtype=np.float32)[axes].reshape(len(texts), 4)


A, B, C, OTHER = np.eye(4, dtype=np.float32)


def words_map(features: dict[int, NDArray[np.float32]]) -> InstanceMap:
    """Instances with these features and without captions, a voxel each."""
    ids = sorted(features)
    index = np.array([[i, 0, 0] for i in ids], np.int32).reshape(-1, 3)
    return labelled_map(index, np.array(ids, np.int32), captions=dict.fromkeys(ids, ""), features=features)


def words_truth(instance: list[int], category: list[int], categories: dict[int, str]) -> Truth:
    n = len(instance)
    return Truth(np.zeros((n, 3)), np.array(instance), np.array(category), categories=categories)


WALL, APPLE, BOWL = 1, 2, 3
ROOM = words_truth(
    [0] * 4 + [1] * 4 + [2] * 2, [WALL] * 4 + [APPLE] * 4 + [BOWL] * 2, {1: "wall", 2: "apple", 3: "bowl"}
)


def test_points_take_the_category_whose_text_is_nearest_to_their_instance() -> None:
    result = words_map({5: A, 6: B})
    labels = np.array([0, 0, 0, 5, 5, 5, 5, 0, 6, 6])
    s = score_semantics(ROOM, labels, result, Letters(), None)
    assert s is not None
    # background 3 of 3 + 1 + 1, apple 3 of 3 + 1 + 1, bowl 2 of 2; on object points alone apple 3 of 4
    assert s.miou == pytest.approx((3 / 5 + 3 / 5 + 1) / 3)
    assert s.macc == pytest.approx((3 / 4 + 3 / 4 + 1) / 3)
    assert s.miou_objects == pytest.approx((3 / 4 + 1) / 2)


def test_an_instance_that_takes_a_category_of_the_background_counts_as_background() -> None:
    labels = np.array([5] * 4 + [6] * 4 + [7] * 2)
    s = score_semantics(ROOM, labels, words_map({5: OTHER, 6: A, 7: B}), Letters(), None)  # 5 is a wall
    assert s is not None
    assert (s.miou, s.macc, s.miou_objects) == (1, 1, 1)


def test_an_instance_without_a_feature_counts_as_background() -> None:
    s = score_semantics(ROOM, np.array([0] * 4 + [5] * 6), words_map({5: np.zeros(4, np.float32)}), Letters(), None)
    assert s is not None
    assert s.miou == pytest.approx((4 / 10 + 0 + 0) / 3)


def test_classes_replace_the_truths_categories_and_other_objects_are_left_out() -> None:
    result = words_map({5: A, 6: B})
    labels = np.array([0] * 4 + [5, 5, 5, 6] + [6, 6])
    # no bowl in the list: its points are left out; instance 6 is nearest to "button", which no point is
    s = score_semantics(ROOM, labels, result, Letters(), ("Apple", "button"))
    assert s is not None
    assert (s.miou, s.macc, s.miou_objects) == ((1 + 3 / 4) / 2, (1 + 3 / 4) / 2, 3 / 4)


def test_of_two_categories_that_are_equally_near_the_lower_number_is_taken() -> None:
    truth = words_truth([1, 1], [8, 8], {8: "apricot", 9: "apple"})
    s = score_semantics(truth, np.array([5, 5]), words_map({5: A}), Letters(), None)
    assert s is not None
    assert s.miou_objects == 1


def test_without_categories_or_points_there_are_no_semantics() -> None:
    bare = replace(ROOM, category=None)
    assert score_semantics(bare, np.zeros(10, int), words_map({}), Letters(), None) is None
    assert class_means(np.zeros(0, int), np.zeros(0, int)) == (None, None)


def test_a_query_finds_an_acceptable_object_at_the_place_of_its_first_good_instance() -> None:
    truth, labels = np.repeat([1, 2, 3], 10), np.repeat([5, 6, 7, 8], [10, 10, 2, 8])
    result = words_map({5: A, 6: A, 7: B, 8: C})
    queries = (
        Query("apple", "ontology", (2,)),  # 5 and 6 are equally near: 5 first, by id
        Query("bowl", "relevance", (3,)),  # 7 holds a fifth of object 3, which is not more than a quarter
        Query("cup", "functionality", (1, 3)),
        Query("apple", "a type of one's own", (1,)),
    )
    found = retrieve(queries, Overlaps.count(truth, labels), result, Letters())
    assert [(one.found_at, one.answers) for one in found] == [
        (2, (5, 6, 7)),
        (4, (7, 5, 6)),
        (1, (8, 5, 6)),
        (1, (5, 6, 7)),
    ]
    assert recalls(found) == {
        "ontology": {"r1": 0, "r2": 1, "r3": 1, "n": 1},
        "relevance": {"r1": 0, "r2": 0, "r3": 0, "n": 1},
        "functionality": {"r1": 1, "r2": 1, "r3": 1, "n": 1},
        "all": {"r1": 0.5, "r2": 0.75, "r3": 0.75, "n": 4},
    }


def test_a_map_without_instances_finds_nothing_and_a_type_without_queries_is_null() -> None:
    found = retrieve(
        (Query("a", "ontology", (1,)),), Overlaps.count(np.ones(3, int), np.zeros(3, int)), words_map({}), Letters()
    )
    assert (found[0].found_at, found[0].answers) == (None, ())
    assert recalls(found)["relevance"] == {"r1": None, "r2": None, "r3": None, "n": 0}


# ---- pictures

WALL_CAMERA = Intrinsics(20, 20, 20.0, 20.0, 9.5, 9.5)


def wall_truth(tmp_path: Path) -> tuple[Path, Path]:
    """One frame that looks straight at a wall in 1 m; object 3 fills its left half (200 pixels), 4 its corner (25)."""
    instances = np.zeros((20, 20), np.uint16)
    instances[:, :10] = 3
    instances[15:, 15:] = 4
    frame = Frame(
        index=6,
        stamp_ns=1,
        world_from_depth=Pose.identity(),
        rig=Rig(WALL_CAMERA, WALL_CAMERA),
        depth=np.full((20, 20), 1000, np.uint16),
        truth_instances=instances,
        truth_categories=instances,
    )
    folder = write_scannet(tmp_path / "scene", [replace(frame, color=tiny_frames(1)[0].color, color_format="jpeg")])
    return record(tmp_path / "wall.mcap", [frame]), folder


def wall_map(columns: range) -> InstanceMap:
    """Voxels of 5 cm just beyond 1 m that fill these of the 20 columns (of one pixel each), instance 8."""
    index = np.array([[x - 10, y - 10, 20] for x in columns for y in range(20)], np.int32).reshape(-1, 3)
    return labelled_map(index, np.full(len(index), 8, np.int32), voxel_size=0.05)


@pytest.mark.parametrize("kind", ["recording", "folder"])
def test_rendered_masks_are_compared_with_every_object_of_a_hundred_pixels(tmp_path: Path, kind: str) -> None:
    recording, folder = wall_truth(tmp_path)
    truth = recording if kind == "recording" else folder
    for columns, expected in (
        (range(10), 1.0),
        (range(5), 0.5),
        (range(20), 0.5),
        (range(5, 15), 50 / 150),
        (range(0), 0),
    ):
        rendered = score_rendered(wall_map(columns), truth, None)
        assert rendered is not None
        assert rendered.iou == pytest.approx(expected)
        assert rendered.detected_iou is None


def test_a_hole_in_the_depth_shows_what_lies_beside_it() -> None:
    depth = np.array([[0, 1000, 0, 0, 2000]], np.uint16)
    assert filled(depth).tolist() == [[1000, 1000, 1000, 2000, 2000]]


def test_without_depth_in_the_same_pixels_voxels_are_drawn_as_cubes(tmp_path: Path) -> None:
    _, folder = wall_truth(tmp_path)
    np.savetxt(folder / "intrinsic" / "intrinsic_depth.txt", np.diag([21.0, 21.0, 1.0, 1.0]))
    (image,) = truth_images(folder)
    assert image.depth is None
    assert image.camera == WALL_CAMERA
    rendered = score_rendered(wall_map(range(5)), folder, None)
    assert rendered is not None
    assert rendered.iou == pytest.approx(0.5)


def perceived(path: Path, recording: Path, masks: Sequence[NDArray[np.bool_]], frame: int = 6) -> Path:
    vector = np.ones(1, np.float32)
    with PerceptionWriter(path, recording_info(recording), stages=[], encoder="test", dimensions=1) as writer:
        found = tuple(Mask.from_bitmap(mask, embedding=vector) for mask in masks)
        writer.add(FrameMasks(frame, 1, "0" * 64, found, (20, 20)))
    return path


def test_detections_are_compared_with_the_same_objects(tmp_path: Path) -> None:
    recording, _ = wall_truth(tmp_path)
    left, top = np.zeros((20, 20), np.bool_), np.zeros((20, 20), np.bool_)
    left[:, :8] = True  # 160 of 200 pixels
    top[:10] = True  # 100 shared of 300
    path = perceived(tmp_path / "a.perception.mcap", recording, [top, left])
    rendered = score_rendered(wall_map(range(10)), recording, path)
    assert rendered is not None
    assert rendered.detected_iou == pytest.approx(0.8)
    nothing = score_rendered(wall_map(range(10)), recording, perceived(tmp_path / "b.mcap", recording, []))
    assert nothing is not None
    assert nothing.detected_iou == 0
    other = score_rendered(wall_map(range(10)), recording, perceived(tmp_path / "c.mcap", recording, [left], frame=5))
    assert other is not None
    assert other.detected_iou is None  # perception did not look at frame 6


def test_a_folder_without_a_pose_for_a_picture_is_one_sentence(tmp_path: Path) -> None:
    _, folder = wall_truth(tmp_path)
    (folder / "pose" / "000006.txt").unlink()
    with pytest.raises(InputError, match="has no pose of frame 6"):
        score_rendered(wall_map(range(3)), folder, None)


# ---- the command


def world_map(frames: Sequence[Frame]) -> InstanceMap:
    """The tiny world's surface under its true ids, in voxels of 5 mm that hold a point each."""
    points = naive_truth(frames)
    label = {tuple(np.floor(np.array(point) / 0.005).astype(int)): key[3] for key, (point, _) in points.items()}
    return labelled_map(
        np.array(list(label), np.int32),
        np.array(list(label.values()), np.int32),
        voxel_size=0.005,
        voxel_confidence=0.75,
    )


LARGER = Intrinsics(width=96, height=72, fx=78.0, fy=78.0, cx=47.5, cy=35.5)
FIGURES = {
    *("ap", "ap50", "ap25", "f50", "miou", "spill", "missed_share", "wrong_share"),
    *("predicted", "true", "split", "merged", "missed"),
}


def test_every_field_is_there_and_what_has_no_truth_is_null(tmp_path: Path) -> None:
    frames = tiny_frames(3, camera=LARGER)
    recording = record(tmp_path / "tiny.mcap", frames)
    perception_path = tmp_path / "tiny.perception.mcap"
    with PerceptionWriter(perception_path, recording_info(recording), stages=[], encoder="x", dimensions=1) as writer:
        for frame in frames:
            assert frame.truth_instances is not None
            masks = [frame.truth_instances == box.instance for box in BOXES]
            found = tuple(Mask.from_bitmap(mask, embedding=np.ones(1, np.float32)) for mask in masks)
            writer.add(FrameMasks(frame.index, frame.stamp_ns, "0" * 64, found, (LARGER.height, LARGER.width)))
    digests = {"perception": perception_info(perception_path).digest}
    meta = {**META, "encoder": "", "perception": perception_path.name, "digests": digests}
    path = tmp_path / "tiny.map.npz"
    write_map(path, replace(world_map(frames), meta=meta))
    seen: list[tuple[int, int]] = []
    result = evaluate(path, truth=recording, progress=lambda done, total: seen.append((done, total)))

    for labelling in ("instances", "instances_in_voxel", "instances_authors_rule"):
        assert result[labelling].keys() == FIGURES
        assert result[labelling]["ap"] == result[labelling]["ap50"] == 1
    assert result["instances"]["true"] == 3
    assert [o["name"] for o in result["objects"]] == ["table 1", "box 2", "box 3"]
    assert {"id", "name", "best_iou", "split_into", "merged_with", "missed"} <= result["objects"][0].keys()
    assert result["calibration"]["ece"] == pytest.approx(0.25)  # all are right, at confidence 0.75
    assert result["rendered_masks"]["detected_iou"] == 1
    assert 0 < result["rendered_masks"]["iou"] < 1
    assert (result["semantics"], result["retrieval"]) == (None, None)
    assert [note[:42] for note in result["notes"]] == [
        "no semantics and retrieval: the map has no",
        "points made from a recording carry its sen",
    ]
    assert seen == [(1, 3), (2, 3), (3, 3)]
    json.dumps(result, allow_nan=False)


def test_a_folder_without_pictures_has_no_rendered_masks_and_words_score_with_the_maps_encoder(tmp_path: Path) -> None:
    from openvox.perception.encoder import encoder

    folder = truth_folder(tmp_path)
    truth = read_truth(folder)
    index, inverse = np.unique(np.floor(truth.points / 0.01 + 1e-6).astype(np.int32), axis=0, return_inverse=True)
    label = np.zeros(len(index), np.int32)
    label[inverse] = truth.instance
    lamp, mug = encoder("minilm").encode(["a small desk lamp", "a coffee mug"])
    result = labelled_map(
        index,
        label,
        voxel_size=0.01,
        captions={4: "a desk lamp", 9: "a mug"},
        features={4: lamp, 9: mug},
        meta={**META, "encoder": "minilm"},
    )
    write_map(tmp_path / "a.map.npz", result)
    scores = evaluate(tmp_path / "a.map.npz", truth=folder)
    assert scores["rendered_masks"] is None
    assert scores["semantics"] == {"miou": 1, "macc": 1, "miou_objects": 1}
    assert scores["retrieval"]["all"] == {"r1": 1, "r2": 1, "r3": 1, "n": 1}
    assert scores["queries"] == [{"text": "a lamp", "type": "ontology", "found_at": 1, "answers": (4, 9)}]
    assert scores["notes"] == []


@pytest.mark.parametrize(
    ("meta", "note"),
    [
        ({"encoder": "someone's own"}, 'no semantics and retrieval: there is no encoder "someone\'s own"'),
        ({"encoder": "minilm"}, "no semantics and retrieval: the map's features have 2 numbers, vectors of minilm 384"),
        ({"encoder": "", "perception": "gone.mcap"}, "no detected_iou: the map's perception file"),
        ({"encoder": "", "perception": "/etc/passwd"}, "no detected_iou: the map names no perception file"),
        ({"encoder": "", "perception": "tiny.mcap"}, "no detected_iou:"),
    ],
)
def test_what_is_missing_to_measure_something_is_a_note_and_no_error(
    tmp_path: Path, meta: dict[str, str], note: str
) -> None:
    frames = tiny_frames(1)
    recording = record(tmp_path / "tiny.mcap", frames)
    write_map(tmp_path / "a.map.npz", replace(world_map(frames), meta=meta))
    result = evaluate(tmp_path / "a.map.npz", truth=recording)
    assert any(note in one for one in result["notes"]), result["notes"]
    assert result["semantics"] is None


def test_perception_of_another_digest_is_not_taken_for_the_maps(tmp_path: Path) -> None:
    recording, _ = wall_truth(tmp_path)
    perceived(tmp_path / "p.mcap", recording, [])
    meta = {"encoder": "", "perception": "p.mcap", "digests": {"perception": "0" * 64}}
    write_map(tmp_path / "a.map.npz", replace(wall_map(range(10)), meta=meta))
    result = evaluate(tmp_path / "a.map.npz", truth=recording)
    assert result["rendered_masks"] == {"iou": 1, "detected_iou": None}
    assert "is not what the map was made from (another digest)" in result["notes"][0]


def test_the_detections_beside_a_room_score_as_their_readme_says(shared_data: Path, tmp_path: Path) -> None:
    from openvox.formats.detections import DetectionFile

    scene = shared_data / "dev_living"
    if not (scene / "detections_noisy.jsonl").is_file():
        pytest.skip(f"no {scene}")
    recording = record(tmp_path / "any.mcap", tiny_frames(1))
    vector = np.ones(1, np.float32)
    with (
        DetectionFile(scene / "detections_noisy.jsonl") as file,
        PerceptionWriter(
            tmp_path / "p.mcap", recording_info(recording), stages=[], encoder="x", dimensions=1
        ) as writer,
    ):
        for frame in file.frames:
            masks = tuple(replace(mask, embedding=vector) for mask in file.read(frame).masks)
            writer.add(FrameMasks(frame, frame, "0" * 64, masks, (480, 640)))
    nothing = labelled_map(np.zeros((0, 3), np.int32), np.zeros(0, np.int32))
    rendered = score_rendered(nothing, scene, tmp_path / "p.mcap")
    assert rendered is not None
    assert rendered.iou == 0
    assert rendered.detected_iou == pytest.approx(0.699, abs=5e-4)
