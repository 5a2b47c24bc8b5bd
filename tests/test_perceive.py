"""perceive: each front end, each stage done once, the same bytes however often, and bad input in a sentence."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import CATEGORIES, tiny_frames

from openvox.apps.perceive import perceive
from openvox.core.errors import InputError, OutputError
from openvox.core.types import Frame, Intrinsics, Mask, Pose
from openvox.formats.detections import Box
from openvox.formats.masks import encode_rle
from openvox.formats.perception import FrameMasks, PerceptionWriter, perception_info, read_masks
from openvox.formats.recording import RecordingWriter, recording_info
from openvox.perception.encoder import encoder
from openvox.perception.geometry import Geometry
from openvox.perception.oracle import OracleMasks
from openvox.perception.pipeline import Pipeline, perceive_frame, perceive_frames

LARGE = Intrinsics(width=160, height=120, fx=130.0, fy=130.0, cx=79.5, cy=59.5)


def record(path: Path, frames: list[Frame]) -> Path:
    with RecordingWriter(path, source="test", categories=CATEGORIES) as writer:
        for frame in frames:
            writer.add(frame)
    return path


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    return record(tmp_path / "tiny.mcap", tiny_frames(4))


@pytest.fixture
def large(tmp_path: Path) -> Path:
    return record(tmp_path / "large.mcap", tiny_frames(4, camera=LARGE))


def detected(x0: int, x1: int, height: int = 24, width: int = 32, **fields: Any) -> dict[str, Any]:
    bitmap = np.zeros((height, width), np.bool_)
    bitmap[3:8, x0:x1] = True
    mask = {"size": [height, width], "counts": encode_rle(bitmap)}
    return {"box": [x0, 3, x1, 8], "score": 0.5, "label": "box", "caption": "a red box", "mask": mask, **fields}


def given(folder: Path, frames: dict[int, list[dict[str, Any]]], **fields: Any) -> Path:
    path = folder / "own.jsonl"
    lines = ({"frame": frame, "detections": found, **fields} for frame, found in frames.items())
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return path


# Front ends


def test_what_needs_no_download_is_the_default_and_is_written_beside_the_recording(large):
    result = perceive(large)
    assert result.output == large.with_name("large.perception.mcap")
    assert (result.frontend, result.frames, result.reused, result.skipped) == ("offline", 4, 0, 0)
    assert set(result.kinds) <= {"object", "region", "support"}
    assert result.encoder == "minilm"
    assert result.notes == ()
    assert result.masks == sum(len(found.masks) for found in read_masks(result.output)) >= 12


def test_regions_from_depth_need_no_model(large):
    result = perceive(large, frontend="geometry")
    assert (result.frontend, result.kinds) == ("geometry", {"region": result.masks})
    assert result.masks >= 12


def test_the_file_knows_its_recording_stages_and_parameters(large):
    result = perceive(large, assignments=["geometry.far=5"], frontend="geometry")
    info = perception_info(result.output)
    assert (info.recording, info.recording_digest) == ("large.mcap", recording_info(large).digest)
    assert [(stage["role"], stage["name"]) for stage in info.stages] == [
        ("det", "none"),
        ("segcap", "geometry"),
        ("enc", "minilm"),
    ]
    assert info.stages[2]["model_digest"] == encoder("minilm").model_digest
    assert info.parameters["geometry.far"] == 5.0
    assert info.digest == result.digest


def test_the_oracle_sees_each_thing_of_the_truth_whole_and_names_it(tiny):
    result = perceive(tiny, frontend="oracle", assignments=["oracle.min_pixels=1"])
    for frame, found in zip(tiny_frames(4), read_masks(result.output, boxes=True), strict=True):
        numbers = [int(number) for number in np.unique(frame.truth_instances) if number]
        assert len(found.masks) == len(numbers)
        for number, mask, box in zip(numbers, found.masks, found.boxes, strict=True):
            np.testing.assert_array_equal(mask.bitmap(24, 32), frame.truth_instances == number)
            assert mask.caption == {1: "a table", 2: "a box", 3: "a box"}[number]
            assert (mask.kind, mask.named, mask.score) == ("object", True, 1.0)
            assert box.corners == mask.box


def test_what_shows_too_few_pixels_is_not_seen_by_the_oracle(tiny):
    pixels = np.bincount(tiny_frames(1)[0].truth_instances.reshape(-1))
    result = perceive(tiny, frontend="oracle", assignments=[f"oracle.min_pixels={pixels[1:].max()}"], end=1)
    assert result.masks == 1


def test_a_mask_is_called_what_most_of_it_is(tmp_path):
    frame = tiny_frames(1)[0]
    categories = frame.truth_categories.copy()
    rows, columns = np.nonzero(frame.truth_instances == 1)
    categories[rows[: len(rows) // 3], columns[: len(rows) // 3]] = 29
    path = record(tmp_path / "mixed.mcap", [replace(frame, truth_categories=categories)])
    found = next(read_masks(perceive(path, frontend="oracle").output))
    assert found.masks[0].caption == "a table"


def test_without_categories_the_oracle_knows_no_names(tmp_path):
    path = record(tmp_path / "plain.mcap", [replace(tiny_frames(1)[0], truth_categories=None)])
    found = next(read_masks(perceive(path, frontend="oracle").output))
    assert {(mask.caption, mask.named) for mask in found.masks} == {("an object", False)}


def test_detections_come_over_in_the_order_of_their_file(tmp_path, tiny):
    path = given(tmp_path, {2: [detected(9, 12, kind="region"), detected(1, 3, caption="a cup")], 0: []})
    result = perceive(tiny, detections=path)
    assert (result.frontend, result.frames, result.masks) == ("detections", 2, 2)
    nothing, two = read_masks(result.output, boxes=True)
    assert (nothing.index, nothing.masks) == (0, ())
    assert (two.index, [mask.caption for mask in two.masks]) == (2, ["a red box", "a cup"])
    assert [mask.kind for mask in two.masks] == ["region", "object"]
    assert two.boxes[0].corners == (9, 3, 12, 8)
    np.testing.assert_array_equal(two.masks[1].embedding, encoder("minilm").encode(["a cup"])[0])


def test_a_mask_without_caption_is_known_by_its_label(tmp_path, tiny):
    result = perceive(tiny, detections=given(tmp_path, {1: [detected(1, 4, caption="", label="sofa")]}))
    (mask,) = next(read_masks(result.output)).masks
    np.testing.assert_array_equal(mask.embedding, encoder("minilm").encode(["sofa"])[0])


def test_embeddings_of_the_users_own_encoder_are_kept_and_named(tmp_path, tiny, monkeypatch):
    monkeypatch.setattr("openvox.perception.encoder.encoder", lambda name: pytest.fail("no encoder is needed"))
    path = given(tmp_path, {1: [detected(1, 4, embedding=[0, 2.0])], 3: []}, encoder="clip-b32")
    result = perceive(tiny, detections=path)
    assert result.encoder == "clip-b32"
    info = perception_info(result.output)
    assert (info.encoder, info.dimensions, info.stages[2]["name"]) == ("clip-b32", 2, "clip-b32")
    assert next(read_masks(result.output)).masks[0].embedding.tolist() == [0.0, 1.0]


def test_frame_numbers_that_the_recording_lacks_are_skipped_and_told(tmp_path, tiny):
    path = given(tmp_path, {1: [detected(1, 4)], 77: [detected(1, 4)], 55: []})
    result = perceive(tiny, detections=path)
    assert (result.frames, result.skipped) == (1, 2)
    assert result.notes == (f"2 frames of {path} are not in the recording and were skipped: 55, 77",)


def test_start_end_and_stride_are_frame_numbers(tmp_path):
    path = record(tmp_path / "gaps.mcap", tiny_frames(6, first=10, stride=3))  # 10 13 16 19 22 25
    result = perceive(path, frontend="oracle", start=13, end=25, stride=2, out=tmp_path / "a.mcap")
    assert [found.index for found in read_masks(result.output)] == [13, 19]
    own = given(tmp_path, {13: [], 16: [], 14: [], 99: []})
    assert perceive(path, detections=own, start=13, end=25, stride=2).notes == ()
    assert perceive(path, detections=own, start=12, end=25, stride=2).skipped == 1  # 14


def test_progress_reaches_its_end(large):
    calls: list[tuple[int, int]] = []
    perceive(large, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_detections_of_a_rendered_room_come_over_whole(tmp_path, shared_data):
    from openvox.sources import open_source

    scene = shared_data / "dev_living"
    path = record(tmp_path / "living.mcap", list(open_source(scene, end=5).frames))
    result = perceive(path, detections=scene / "detections_noisy.jsonl", end=5)
    lines = [json.loads(line) for line in (scene / "detections_noisy.jsonl").read_text().splitlines()[:5]]
    assert [len(found.masks) for found in read_masks(result.output)] == [len(line["detections"]) for line in lines]
    assert result.skipped == 0


# Once


def count_calls(monkeypatch: pytest.MonkeyPatch, kind: Any) -> list[int]:
    """Frames that a stage is called for from now on."""
    calls: list[int] = []
    original = kind.__call__

    def counted(self: Any, frame: Frame, *rest: Any) -> Any:
        calls.append(frame.index)
        return original(self, frame, *rest)

    monkeypatch.setattr(kind, "__call__", counted)
    return calls


def test_a_second_run_does_nothing_and_says_so(large, monkeypatch):
    first = perceive(large, frontend="geometry")
    data, changed = first.output.read_bytes(), first.output.stat().st_mtime_ns
    calls = count_calls(monkeypatch, Geometry)
    monkeypatch.setattr(PerceptionWriter, "add", lambda *_: pytest.fail("nothing is to be written"))
    second = perceive(large, frontend="geometry")
    assert calls == []
    assert (second.reused, second.frames, second.masks, second.digest) == (4, 4, first.masks, first.digest)
    assert (first.untouched, second.untouched) == (False, True)
    assert (second.output.read_bytes(), second.output.stat().st_mtime_ns) == (data, changed)
    assert second.notes == ("large.perception.mcap holds all of that already; nothing was done",)


def test_fewer_frames_of_a_complete_file_are_there_already_and_the_others_stay(large):
    first = perceive(large, frontend="geometry")
    data = first.output.read_bytes()
    for fewer in ({"end": 2}, {"start": 1}, {"stride": 2}):
        again = perceive(large, frontend="geometry", **fewer)
        assert again.output.read_bytes() == data
        assert again.notes == ("large.perception.mcap holds all of that already; nothing was done",)


def test_frames_that_are_not_asked_for_stay_beside_new_ones(large, monkeypatch):
    perceive(large, frontend="geometry", start=2)
    calls = count_calls(monkeypatch, Geometry)
    second = perceive(large, frontend="geometry", end=1)
    assert calls == [0]
    assert [found.index for found in read_masks(second.output)] == [0, 2, 3]
    assert (second.frames, second.reused) == (3, 2)
    assert second.notes[-1] == "2 frames that were not asked for stay in large.perception.mcap as they were"
    whole = perceive(large, frontend="geometry", out=large.with_name("whole.mcap"))
    assert perceive(large, frontend="geometry").digest == whole.digest


def test_frames_that_are_not_asked_for_and_were_made_in_another_way_are_not_lost(large):
    first = perceive(large, frontend="geometry")
    data = first.output.read_bytes()
    with pytest.raises(InputError, match=r"large.perception.mcap holds 2 frames that are not asked for and were made"):
        perceive(large, frontend="geometry", end=2, assignments=["geometry.far=4"])
    record(large, tiny_frames(5, camera=LARGE)[1:])
    with pytest.raises(InputError, match=r"holds 4 frames that are not asked for .* or another recording"):
        perceive(large, frontend="geometry", start=4)
    assert first.output.read_bytes() == data
    assert sorted(entry.name for entry in large.parent.iterdir()) == ["large.mcap", "large.perception.mcap"]


def test_a_frame_that_the_detections_no_longer_speak_of_goes(tmp_path, tiny):
    perceive(tiny, detections=given(tmp_path, {0: [detected(1, 4)], 2: []}))
    result = perceive(tiny, detections=given(tmp_path, {0: [detected(1, 4)]}))
    assert [found.index for found in read_masks(result.output)] == [0]


def test_more_frames_cost_only_what_is_new(large, monkeypatch):
    perceive(large, start=1, end=3, frontend="geometry")
    calls = count_calls(monkeypatch, Geometry)
    assert perceive(large, frontend="geometry").reused == 2
    assert sorted(calls) == [0, 3]


def test_another_parameter_is_another_result(large):
    first = perceive(large, frontend="geometry")
    second = perceive(large, assignments=["geometry.min_pixels=1000"], frontend="geometry")
    assert second.reused == 0
    assert second.masks < first.masks


def test_another_trajectory_keeps_what_does_not_depend_on_it(tmp_path, monkeypatch):
    frames = tiny_frames(3)
    path = record(tmp_path / "a.mcap", frames)
    first = perceive(path, frontend="oracle")
    moved = [replace(frame, world_from_depth=Pose.identity(), stamp_ns=frame.stamp_ns + 5) for frame in frames]
    record(path, moved)
    second = perceive(path, frontend="oracle")
    assert (second.reused, second.digest) == (3, first.digest)
    assert [found.stamp_ns for found in read_masks(second.output)] == [frame.stamp_ns for frame in moved]


def test_regions_are_found_anew_where_the_pose_moves_the_background(tmp_path):
    frames = tiny_frames(3, camera=LARGE)
    path = record(tmp_path / "a.mcap", frames)
    perceive(path, frontend="geometry")
    raised = Pose(frames[1].world_from_depth.quaternion, (0.0, 0.0, 9.0))
    record(path, [frames[0], replace(frames[1], world_from_depth=raised), frames[2]])
    assert perceive(path, assignments=["geometry.planes=false"], frontend="geometry").reused == 0


def test_another_truth_is_another_oracle(tmp_path, monkeypatch):
    frames = tiny_frames(3)
    path = record(tmp_path / "a.mcap", frames)
    perceive(path, frontend="oracle")
    swapped = np.where(frames[1].truth_instances == 1, 9, frames[1].truth_instances).astype(np.uint16)
    record(path, [frames[0], replace(frames[1], truth_instances=swapped), frames[2]])
    calls = count_calls(monkeypatch, OracleMasks)
    assert perceive(path, frontend="oracle").reused == 2
    assert calls == [1]


def test_another_file_of_detections_is_read_anew(tmp_path, tiny):
    perceive(tiny, detections=given(tmp_path, {0: [detected(1, 4)]}))
    assert perceive(tiny, detections=given(tmp_path, {0: [detected(1, 4)]})).reused == 1
    result = perceive(tiny, detections=given(tmp_path, {0: [detected(1, 5)]}))
    assert result.reused == 0
    assert next(read_masks(result.output)).masks[0].area == 20


def test_the_number_of_workers_changes_no_byte(large):
    outputs = []
    for jobs in (1, 2, 5):
        out = large.with_name(f"{jobs}.mcap")
        perceive(large, jobs=jobs, out=out, frontend="geometry")
        outputs.append(out.read_bytes())
    assert outputs[0] == outputs[1] == outputs[2]


def test_a_damaged_older_file_is_no_obstacle(large):
    result = perceive(large, frontend="geometry")
    data = bytearray(result.output.read_bytes())
    data[data.index(b"zstd") + 20] ^= 1
    result.output.write_bytes(data)
    again = perceive(large, frontend="geometry")
    assert (again.reused, again.digest) == (0, result.digest)
    assert "could not be used again from there on" in again.notes[-1]
    assert perceive(large, frontend="geometry").reused == 4


def test_what_a_killed_run_had_done_is_not_done_again(tmp_path, monkeypatch):
    frames = [replace(frame, stamp_ns=i * 1_000_000_000) for i, frame in enumerate(tiny_frames(6, camera=LARGE))]
    path = record(tmp_path / "a.mcap", frames)
    result = perceive(path, frontend="geometry")
    data = result.output.read_bytes()
    partial = result.output.with_name(result.output.name + ".partial")
    partial.write_bytes(data[: len(data) // 2])
    result.output.unlink()
    calls = count_calls(monkeypatch, Geometry)
    again = perceive(path, frontend="geometry")
    assert 0 < again.reused < 6
    assert sorted(calls) == list(range(again.reused, 6))
    assert again.output.read_bytes() == data
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.mcap", "a.perception.mcap"]


class Counting:
    """A stage that numbers its outputs; `salt` stands for parameters or a model."""

    parameters: dict[str, Any] = {}  # noqa: RUF012
    model_digest = ""
    dimensions = 1

    def __init__(self, name: str, salt: int = 0) -> None:
        self.name = name
        self.salt = salt
        self.calls: list[int] = []

    def digest(self, frame: Frame) -> str:
        return f"{self.name}{self.salt}"

    def looks_at(self, frame: Frame) -> bool:
        return frame.index != 2

    def __call__(self, frame: Frame, *given: Any) -> Any:
        self.calls.append(frame.index)
        if self.name == "det":
            return (Box((0, 0, 1, 1), 0.5, f"{self.salt}"),)
        if self.name == "segcap":
            return (Mask.from_bitmap(np.ones((24, 32), np.bool_), label=given[0][0].label, caption=f"{self.salt}"),)
        return np.full((len(given[0]), 1), self.salt, np.float32)


def stages(det: int = 0, segcap: int = 0, enc: int = 0) -> Pipeline:
    return Pipeline(Counting("det", det), Counting("segcap", segcap), Counting("enc", enc))


@pytest.mark.parametrize(
    ("changed", "done_again"),
    [({}, []), ({"enc": 1}, ["enc"]), ({"segcap": 1}, ["segcap", "enc"]), ({"det": 1}, ["det", "segcap", "enc"])],
)
def test_a_change_of_a_stage_redoes_it_and_what_follows(changed, done_again):
    (frame,) = tiny_frames(1)
    before, ran = perceive_frame(stages(), frame)
    assert ran == ("det", "segcap", "enc")
    pipeline = stages(**changed)
    after, ran = perceive_frame(pipeline, frame, [before])
    assert [stage.name for stage in (pipeline.det, pipeline.segcap, pipeline.enc) if stage.calls] == done_again
    assert list(ran) == done_again
    assert after.boxes[0].label == str(changed.get("det", 0))
    assert after.masks[0].caption == str(changed.get("segcap", 0))
    assert after.masks[0].embedding.tolist() == [changed.get("enc", 0)]


def test_another_picture_of_the_same_number_is_not_taken_for_the_old():
    (frame,) = tiny_frames(1)
    before, _ = perceive_frame(stages(), frame)
    _, ran = perceive_frame(stages(), replace(frame, color=frame.color + b" "), [before])
    assert ran == ("det", "segcap", "enc")


def test_frames_come_in_order_however_long_each_takes_and_few_are_held():
    frames = tiny_frames(12)
    read: list[int] = []
    longest = 0

    class Uneven(Counting):
        def __call__(self, frame: Frame, *given: Any) -> Any:
            time.sleep(0.004 * (frame.index % 3))
            return super().__call__(frame, *given)

    def reading() -> Iterator[Frame]:
        for frame in frames:
            read.append(frame.index)
            yield frame

    pipeline = Pipeline(Uneven("det"), Counting("segcap"), Counting("enc"))
    done: list[int] = []
    for frame, found in perceive_frames(pipeline, reading(), jobs=3):
        done.append(frame.index)
        assert (found is None) is (frame.index == 2)
        longest = max(longest, len(read) - len(done))
    assert done == list(range(12))
    assert 0 < longest <= 6


def test_an_error_in_a_worker_is_raised_where_the_frames_are_taken():
    class Broken(Counting):
        def __call__(self, frame: Frame, *given: Sequence[Any]) -> Any:
            raise InputError(f"frame {frame.index} is broken")

    pipeline = Pipeline(Broken("det"), Counting("segcap"), Counting("enc"))
    with pytest.raises(InputError, match="frame 0 is broken"):
        list(perceive_frames(pipeline, tiny_frames(9), jobs=2))


def test_frames_found_earlier_are_matched_by_number():
    frames = tiny_frames(5)
    earlier = [perceive_frame(stages(), frames[i])[0] for i in (1, 3)]
    done = {frame.index: found for frame, found in perceive_frames(stages(), frames, [iter(earlier)])}
    assert {index for index, found in done.items() if found and not found[1]} == {1, 3}
    assert {index for index, found in done.items() if found and found[1]} == {0, 4}
    assert isinstance(done[1][0], FrameMasks)


# Bad input


def test_masks_of_another_size_than_the_colour_image_are_refused(tmp_path, tiny):
    path = given(tmp_path, {0: [], 1: [*[detected(1, 4)] * 3, detected(1, 4, 240, 320)]})
    with pytest.raises(
        InputError,
        match=r"own.jsonl:2: frame 1, mask 3: mask is 320x240, the colour image 32x24; export masks at the colour",
    ):
        perceive(tiny, detections=path)
    assert not tiny.with_name("tiny.perception.mcap").exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"frontend": "oracle", "detections": Path("x.jsonl")}, "--frontend oracle and --detections x.jsonl are both"),
        ({"frontend": "oracle", "assignments": ["geometry.far=3"]}, "geometry.far has no effect here, because masks"),
        (
            {"assignments": ["oracle.min_pixels=3"]},
            "oracle.min_pixels has no effect here, because masks are found by offline",
        ),
        ({"assignments": ["geometry.fat=3"]}, "there is no parameter 'geometry.fat'; did you mean geometry.far"),
        ({"assignments": ["geometry.far=-3"]}, "geometry.far is -3 m; expected 0.1 .. 65"),
        (
            {"assignments": ["geometry.planes=off", "geometry.plane_area=2"]},
            "geometry.plane_area has no effect here, because geometry.planes is off",
        ),
        ({"detections": Path("none.jsonl")}, "none.jsonl: cannot be read"),
        ({"start": 70}, "tiny.mcap has frames 0 to 3, none of which is asked for"),
        ({"stride": 0}, "stride is 0"),
        ({"jobs": 0}, "--jobs is 0; expected 1 or more"),
    ],
)
def test_options_that_do_not_go_together_are_a_sentence(tiny, options, sentence):
    with pytest.raises(InputError, match=sentence):
        perceive(tiny, **options)
    assert sorted(entry.name for entry in tiny.parent.iterdir()) == ["tiny.mcap"]


def test_parameters_do_not_go_with_detections(tmp_path, tiny):
    with pytest.raises(InputError, match=r"geometry.far has no effect here, because masks come as they are"):
        perceive(tiny, detections=given(tmp_path, {0: []}), assignments=["geometry.far=3"])


def test_an_oracle_without_truth_is_a_sentence(tmp_path):
    path = record(tmp_path / "blind.mcap", tiny_frames(1, truth=False))
    with pytest.raises(InputError, match=r"blind.mcap has no ground truth, .* use --frontend offline or --detections"):
        perceive(path, frontend="oracle")


def test_detections_of_another_recording_are_a_sentence(tmp_path, tiny):
    with pytest.raises(InputError, match=r"own.jsonl speaks of frames 70 to 80, but none of them .* frames 0 to 3"):
        perceive(tiny, detections=given(tmp_path, {70: [], 80: []}))
    with pytest.raises(InputError, match=r"own.jsonl is empty; expected a line for each frame"):
        perceive(tiny, detections=given(tmp_path, {}))


def test_an_input_is_not_written_over(tmp_path, tiny):
    with pytest.raises(InputError, match=r"tiny.mcap is an input; name another file"):
        perceive(tiny, out=tiny, frontend="geometry")
    own = given(tmp_path, {0: []})
    with pytest.raises(InputError, match=r"own.jsonl is an input"):
        perceive(tiny, detections=own, out=own)


def test_only_what_was_perceived_is_written_over(tmp_path, tiny):
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    other = record(tmp_path / "other.mcap", tiny_frames(2))
    for path in (notes, other):
        before = path.read_bytes()
        with pytest.raises(OutputError, match=rf"{path.name} exists and is no perception file; name another"):
            perceive(tiny, out=path, frontend="geometry")
        assert path.read_bytes() == before
    (tmp_path / "old.perception.mcap").write_bytes(b"damaged")
    perceive(tiny, out=tmp_path / "old.perception.mcap", frontend="geometry")
    perceive(tiny, out=tmp_path / "free.mcap", frontend="geometry")
    assert perceive(tiny, out=tmp_path / "free.mcap", frontend="oracle").frames == 4


def test_a_range_without_frames_is_a_sentence_whatever_the_cache_holds(tiny):
    perceive(tiny, frontend="geometry")
    for chosen in ({"start": 500}, {"start": 3, "end": 1}):
        with pytest.raises(InputError, match=r"frames 0 to 3, none of which is asked for"):
            perceive(tiny, frontend="geometry", **chosen)


def test_a_folder_and_a_perception_file_are_no_recordings(tmp_path, tiny):
    with pytest.raises(InputError, match=r"is a folder; make a recording of it first: openvox ingest"):
        perceive(tmp_path)
    written = perceive(tiny, frontend="geometry").output
    with pytest.raises(InputError, match=r"is what was perceived in a recording; give the recording, tiny\.mcap"):
        perceive(written)


def test_a_recording_that_is_not_there_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match=r"there is no file .*none.mcap"):
        perceive(tmp_path / "none.mcap", frontend="geometry")


def test_a_damaged_recording_leaves_the_older_result_as_it_was(large):
    result = perceive(large, frontend="geometry")
    before = result.output.read_bytes()
    data = bytearray(large.read_bytes())
    data[len(data) // 2] ^= 1
    large.write_bytes(data)
    with pytest.raises(InputError, match=r"large.mcap is damaged"):
        perceive(large, frontend="geometry")
    assert result.output.read_bytes() == before
    assert not list(large.parent.glob("*.partial"))


def test_a_place_that_cannot_be_written_is_a_sentence(tiny):
    with pytest.raises(OutputError, match=r"none/a.mcap could not be written"):
        perceive(tiny, frontend="oracle", out=tiny.parent / "none" / "a.mcap")


def test_after_an_interrupt_the_next_run_goes_on_from_what_was_done(tiny, monkeypatch):
    add = PerceptionWriter.add

    def until_the_third(self, found):
        if self.frames == 2:
            raise KeyboardInterrupt
        add(self, found)

    monkeypatch.setattr(PerceptionWriter, "add", until_the_third)
    with pytest.raises(KeyboardInterrupt):
        perceive(tiny, frontend="oracle")
    monkeypatch.undo()
    assert perceive(tiny, frontend="oracle").reused == 2
    assert not list(tiny.parent.glob("*.partial"))
