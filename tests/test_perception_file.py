"""Perception files: exact both ways, readable by others, the same bytes for the same frames, damage in a sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from worlds import tiny_frames

from openvox.core.errors import InputError, OutputError
from openvox.core.types import Mask
from openvox.formats import perception_schemas as schemas
from openvox.formats.detections import Box
from openvox.formats.mcap_io import McapWriter
from openvox.formats.perception import (
    METADATA,
    FrameMasks,
    PerceptionWriter,
    interrupted,
    perception_info,
    read_masks,
    read_unfinished,
)
from openvox.formats.recording import RecordingInfo, RecordingWriter

STAGES = [
    {"role": "det", "name": "none", "parameters": {}, "model_digest": ""},
    {"role": "segcap", "name": "geometry", "parameters": {"geometry.far": 5.0}, "model_digest": ""},
    {"role": "enc", "name": "minilm", "parameters": {}, "model_digest": "ab" * 32},
]
EAST, NORTH = np.array([1, 0, 0], np.float32), np.array([0, 0.6, 0.8], np.float32)


def bar(x0: int, x1: int, embedding: np.ndarray = EAST, **fields: Any) -> Mask:
    bitmap = np.zeros((24, 32), np.bool_)
    bitmap[5:9, x0:x1] = True
    bitmap[6, x0] = False
    return Mask.from_bitmap(bitmap, embedding=embedding, **fields)


FRAMES = (
    FrameMasks(
        index=0,
        stamp_ns=1_000_000_000,
        frame_digest="0a" * 32,
        masks=(
            bar(2, 20, score=0.8, label="table", caption="a grey table", caption_score=0.7),
            bar(11, 13, NORTH, caption="a red cup", kind="support", alternatives=(("mug", "a red mug", 0.25),)),
            bar(14, 17, caption="a grey table", named=False, kind="region"),
        ),
        size=(24, 32),
        boxes=(Box((1.5, 5.0, 20.25, 9.0), 0.8, "table"),),
        stage_digests=("d0", "s0", "e0"),
    ),
    FrameMasks(4, 1_400_000_000, "0b" * 32, (), (24, 32), (), ("d0", "s0", "e0")),
    FrameMasks(9, 1_900_000_000, "0c" * 32, (bar(0, 32, NORTH, caption="Tür"),), (24, 32), (), ("d0", "s0", "e0")),
)


@pytest.fixture
def recording(tmp_path: Path) -> RecordingInfo:
    (tmp_path / "logs").mkdir()
    with RecordingWriter(tmp_path / "logs" / "tiny.mcap", source="test") as writer:
        for frame in tiny_frames(1):
            writer.add(frame)
    return writer.info()


def write(path: Path, recording: RecordingInfo, frames: tuple[FrameMasks, ...] = FRAMES) -> Path:
    with PerceptionWriter(path, recording, stages=STAGES, encoder="minilm", dimensions=3) as writer:
        for frame in frames:
            writer.add(frame)
    return path


def assert_same(actual: list[FrameMasks], expected: tuple[FrameMasks, ...], boxes: bool = True) -> None:
    for a, b in zip(actual, expected, strict=True):
        assert (a.index, a.stamp_ns, a.frame_digest, a.size) == (b.index, b.stamp_ns, b.frame_digest, b.size)
        assert (a.boxes, a.stage_digests) == ((b.boxes, b.stage_digests) if boxes else ((), ("", *b.stage_digests[1:])))
        for x, y in zip(a.masks, b.masks, strict=True):
            np.testing.assert_array_equal(x.bits, y.bits, strict=True)
            np.testing.assert_array_equal(x.embedding, y.embedding, strict=True)
            assert (x.box, x.score, x.label, x.kind) == (y.box, y.score, y.label, y.kind)
            assert (x.caption, x.caption_score, x.named) == (y.caption, y.caption_score, y.named)
            assert x.alternatives == y.alternatives


def test_masks_captions_and_embeddings_come_back_exactly(tmp_path, recording):
    assert_same(list(read_masks(write(tmp_path / "a.mcap", recording))), FRAMES, boxes=False)


def test_the_boxes_of_the_detector_come_back_when_asked_for(tmp_path, recording):
    assert_same(list(read_masks(write(tmp_path / "a.mcap", recording), boxes=True)), FRAMES)


def test_a_file_says_what_it_is_made_of(tmp_path, recording):
    info = perception_info(write(tmp_path / "a.mcap", recording))
    assert (info.recording, info.recording_digest) == ("logs/tiny.mcap", recording.digest)
    assert (info.encoder, info.dimensions, info.frames, info.masks) == ("minilm", 3, 3, 4)
    assert info.kinds == {"object": 2, "region": 1, "support": 1}
    assert [stage["name"] for stage in info.stages] == ["none", "geometry", "minilm"]
    assert info.parameters == {"geometry.far": 5.0}
    assert info.metadata["openvox_version"]


def test_a_frame_that_was_not_looked_at_is_absent_and_one_without_masks_is_empty(tmp_path, recording):
    found = {frame.index: len(frame.masks) for frame in read_masks(write(tmp_path / "a.mcap", recording))}
    assert found == {0: 3, 4: 0, 9: 1}


def test_start_and_end_are_frame_numbers(tmp_path, recording):
    path = write(tmp_path / "a.mcap", recording)
    assert [frame.index for frame in read_masks(path, start=1)] == [4, 9]
    assert [frame.index for frame in read_masks(path, start=4, end=9)] == [4]
    assert [frame.index for frame in read_masks(path, end=0)] == []


def test_the_same_frames_give_the_same_bytes(tmp_path, recording):
    first, second = (write(tmp_path / name, recording).read_bytes() for name in ("a.mcap", "b.mcap"))
    assert first == second


@pytest.mark.parametrize(
    ("change", "same"),
    [
        ({}, True),
        ({"stamp_ns": 1_000_000_001}, True),
        ({"stage_digests": ("x", "y", "z")}, True),
        ({"frame_digest": "0d" * 32}, False),
        ({"boxes": ()}, False),
        ({"masks": FRAMES[0].masks[:2]}, False),
        ({"masks": (replace(FRAMES[0].masks[0], caption="a table"), *FRAMES[0].masks[1:])}, False),
        ({"masks": (replace(FRAMES[0].masks[0], bits=FRAMES[0].masks[0].bits ^ 1), *FRAMES[0].masks[1:])}, False),
        ({"masks": (replace(FRAMES[0].masks[0], embedding=NORTH), *FRAMES[0].masks[1:])}, False),
    ],
)
def test_the_digest_tells_another_content_but_not_another_time_or_maker(tmp_path, recording, change, same):
    digest = perception_info(write(tmp_path / "a.mcap", recording)).digest
    changed = (replace(FRAMES[0], **change), *FRAMES[1:])
    assert (perception_info(write(tmp_path / "b.mcap", recording, changed)).digest == digest) is same


def test_equal_vectors_of_a_frame_are_stored_once():
    vectors = np.stack([EAST, NORTH, EAST])
    message = schemas._CLASS["Embeddings"].FromString(schemas.encode_embeddings(5, ("a", "b"), "minilm", vectors))
    assert (len(message.vectors), list(message.vector_of_mask)) == (2 * 3 * 4, [0, 1, 0])


def stock_messages(path: Path) -> list[tuple[str, int, int, Any]]:
    """What a reader that knows nothing of openvox sees: messages through the descriptors in the file."""
    out = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            pool = descriptor_pool.DescriptorPool()
            for entry in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(entry)
            decoder = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            out.append((channel.topic, message.sequence, message.log_time, decoder.FromString(message.data)))
    return out


def test_any_mcap_reader_understands_the_messages_with_the_descriptors_in_the_file(tmp_path, recording):
    messages = stock_messages(write(tmp_path / "a.mcap", recording))
    assert [(topic, sequence, time) for topic, sequence, time, _ in messages[:4]] == [
        ("/perception/detections", 0, 1_000_000_000),
        ("/perception/masks", 0, 1_000_000_000),
        ("/perception/embeddings", 0, 1_000_000_000),
        ("/perception/annotations", 0, 1_000_000_000),
    ]
    boxes, masks, vectors, _ = (message for _, _, _, message in messages[:4])
    assert [(box.x0, box.x1, box.label) for box in boxes.detections] == [(1.5, 20.25, "table")]
    assert [mask.caption for mask in masks.masks] == ["a grey table", "a red cup", "a grey table"]
    assert (masks.width, masks.height, masks.frame_id) == (32, 24, "camera_color")
    assert {message.frame_digest for message in (boxes, masks, vectors)} == {"0a" * 32}
    assert [message.stage_digest for message in (boxes, masks, vectors)] == ["d0", "s0", "e0"]
    assert np.frombuffer(vectors.vectors, "<f4").reshape(-1, 3).tolist() == [EAST.tolist(), NORTH.tolist()]


def test_boxes_and_captions_are_annotations_that_foxglove_draws(tmp_path, recording):
    path = write(tmp_path / "a.mcap", recording)
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages(["/perception/annotations"]))
    assert found[0][0].name == "foxglove.ImageAnnotations"
    drawn = ImageAnnotations.FromString(found[0][2].data)
    assert [text.text for text in drawn.texts] == ["0 a grey table", "1 a red cup", "2 a grey table"]
    assert [(p.x, p.y) for p in drawn.points[0].points] == [(2, 5), (20, 5), (20, 9), (2, 9)]


def test_what_is_no_perception_file_is_told_so(tmp_path, recording):
    with pytest.raises(InputError, match=r"tiny.mcap has no metadata record openvox.perception"):
        list(read_masks(recording.path))
    (tmp_path / "a.mcap").write_bytes(b"hello")
    with pytest.raises(InputError, match=r"a.mcap is no MCAP file"):
        perception_info(tmp_path / "a.mcap")


def test_a_newer_format_is_refused_in_a_sentence(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as file:
        file.metadata(METADATA, {"format_version": "2"})
    with pytest.raises(InputError, match=r"format version 2 .* use a newer openvox"):
        perception_info(tmp_path / "a.mcap")


def test_metadata_without_its_fields_is_a_sentence(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as file:
        file.metadata(METADATA, {"format_version": "1"})
    with pytest.raises(InputError, match=r"its metadata openvox.perception cannot be read"):
        perception_info(tmp_path / "a.mcap")


def written_by_hand(path: Path, *messages: tuple[Any, bytes]) -> Path:
    """One frame, number 7, of any messages, and metadata that promise it."""
    record = dict.fromkeys(("recording", "recording_digest", "encoder", "digest"), "x")
    record |= {"format_version": "1", "frames": "1", "masks": "1", "dimensions": "3", "stages": "[]", "kinds": "{}"}
    with McapWriter(path) as file:
        for topic, data in messages:
            file.add(topic, 7, 5, data)
        file.metadata(METADATA, record)
    return path


MASKS = (schemas.MASKS, schemas.encode_masks(5, ("a", "b"), (24, 32), [bar(3, 6)]))
VECTORS = (schemas.EMBEDDINGS, schemas.encode_embeddings(5, ("a", "b"), "x", EAST[None]))


def vector_message(**fields: Any) -> tuple[Any, bytes]:
    return schemas.EMBEDDINGS, schemas._CLASS["Embeddings"](**fields).SerializeToString()


def mask_message(**fields: Any) -> tuple[Any, bytes]:
    return schemas.MASKS, schemas._CLASS["Masks"](width=32, height=24, masks=[fields]).SerializeToString()


@pytest.mark.parametrize(
    ("messages", "sentence"),
    [
        ((), "holds 0 frames, its metadata say 1; run perceive again"),
        ((MASKS,), "the last frame lacks messages"),
        ((MASKS, MASKS, VECTORS), "the message on /perception/masks of frame 7 is out of place"),
        ((MASKS, (schemas.EMBEDDINGS, b"\xff")), "a.mcap, frame 7: .*; run perceive again"),
        ((MASKS, vector_message(dimensions=0)), "frame 7: 0 bytes are no vectors of 0 float32 numbers"),
        ((MASKS, vector_message(dimensions=3, vectors=b"12345")), "5 bytes are no vectors of 3 float32 numbers"),
        ((MASKS, vector_message(dimensions=3, vector_of_mask=[0])), "a mask has vector 0 of 0"),
        ((MASKS, vector_message(dimensions=3, vectors=bytes(12))), "1 masks have 0 vectors"),
        (
            (MASKS, vector_message(dimensions=1 << 20, vectors=bytes(1 << 22), vector_of_mask=[0] * 999)),
            "999 masks with vectors of 1048576 numbers are too many",
        ),
        ((MASKS, vector_message(dimensions=1, vectors=bytes(4), vector_of_mask=[0])), "a vector has not 3 numbers"),
        ((mask_message(x1=33, y1=1, bits=bytes(5), kind="object"), VECTORS), "mask 0 reaches out of the picture"),
        ((mask_message(x1=32, y1=24, bits=bytes(5), kind="object"), VECTORS), "expected 96 bytes for box"),
        ((mask_message(x1=1, y1=1, bits=b"\x80", kind="thing"), VECTORS), "mask kind is 'thing'"),
        ((mask_message(kind="object", score=2.0), VECTORS), "mask scores are 2.0"),
    ],
)
def test_messages_that_do_not_fit_together_are_a_sentence(tmp_path, messages, sentence):
    with pytest.raises(InputError, match=sentence):
        list(read_masks(written_by_hand(tmp_path / "a.mcap", *messages)))


def test_an_error_while_writing_leaves_the_older_file_as_it_was(tmp_path, recording):
    path = write(tmp_path / "a.mcap", recording)
    before = path.read_bytes()
    without_embedding = replace(FRAMES[1], masks=(replace(FRAMES[0].masks[0], embedding=None),))
    with pytest.raises(AssertionError, match="a mask without embedding"):
        write(path, recording, (FRAMES[0], without_embedding))
    assert path.read_bytes() == before
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.mcap", "logs"]


def test_a_folder_that_is_not_there_is_a_sentence(tmp_path, recording):
    with pytest.raises(OutputError, match=r"none/a.mcap could not be written"):
        write(tmp_path / "none" / "a.mcap", recording)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    folder = tmp_path_factory.mktemp("whole")
    with RecordingWriter(folder / "tiny.mcap", source="test") as writer:
        writer.add(tiny_frames(1)[0])
    return write(folder / "a.mcap", writer.info()).read_bytes()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None)
@given(data=st.data())
def test_a_cut_file_is_one_sentence(tmp_path, whole, data):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    with pytest.raises(InputError, match=r"cut.mcap"):
        list(read_masks(path, boxes=True))


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=120, deadline=None)
@given(data=st.data())
def test_a_flipped_bit_is_one_sentence_or_without_effect(tmp_path, whole, data):
    path, flipped = tmp_path / "flip.mcap", bytearray(whole)
    flipped[data.draw(st.integers(0, len(whole) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(flipped)
    try:
        found = list(read_masks(path, boxes=True))
    except InputError:
        return
    assert_same(found, FRAMES)


def many(count: int) -> tuple[FrameMasks, ...]:
    """Frames a second apart, so that each has a chunk of its own."""
    return tuple(replace(FRAMES[0], index=i, stamp_ns=i * 1_000_000_000) for i in range(count))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_of_an_interrupted_file_the_whole_frames_can_be_read(tmp_path, recording, share):
    data = write(tmp_path / "a.mcap", recording, many(10)).read_bytes()
    (tmp_path / "b.mcap.partial").write_bytes(data[: int(share * len(data))])
    found = list(read_unfinished(tmp_path / "b.mcap.partial"))
    assert 0 < len(found) <= 10
    assert_same(found, many(len(found)))


def test_an_interrupted_file_that_is_rubbish_has_no_frames(tmp_path):
    path = tmp_path / "a.mcap.partial"
    for rubbish in (b"", b"hello", b"\x89MCAP0\r\n" + b"\xff" * 40):
        path.write_bytes(rubbish)
        assert list(read_unfinished(path)) == []


def test_what_an_interrupted_run_left_is_moved_away_and_the_larger_of_two_is_kept(tmp_path):
    path = tmp_path / "a.mcap"
    partial, kept = tmp_path / "a.mcap.partial", tmp_path / "a.mcap.earlier.partial"
    assert interrupted(path) is None
    partial.write_bytes(b"12")
    assert interrupted(path) == kept
    assert kept.read_bytes() == b"12"
    partial.write_bytes(b"1")
    assert interrupted(path) == kept
    assert kept.read_bytes() == b"12"
    partial.write_bytes(b"123")
    assert interrupted(path) == kept
    assert (kept.read_bytes(), partial.exists()) == (b"123", False)
