"""Recordings: exact both ways, the same bytes for the same frames, readable by stock MCAP readers and by Rerun."""

from __future__ import annotations

import gc
import json
import struct
import threading
import time
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.reader import make_reader
from mcap.records import ChunkIndex, Message
from worlds import CAMERA, CATEGORIES, tiny_frames

from openvox.core.digest import START, frame_digest, recording_link
from openvox.core.errors import InputError, OutputError
from openvox.core.types import Frame, Intrinsics, Pose, Rig
from openvox.formats.ahead import read_ahead
from openvox.formats.images import decode_color, decode_png16, encode_jpeg, encode_png
from openvox.formats.mcap_io import McapWriter, Topic, read_messages
from openvox.formats.recording import RecordingWriter, read_frames, recording_info


def record(path: Path, frames: list[Frame], **fields: Any) -> Path:
    with RecordingWriter(path, source="test", categories=CATEGORIES, **fields) as writer:
        for frame in frames:
            writer.add(frame)
    return path


def assert_same(actual: list[Frame], expected: list[Frame]) -> None:
    for a, b in zip(actual, expected, strict=True):
        assert (a.index, a.stamp_ns, a.world_from_depth, a.rig) == (b.index, b.stamp_ns, b.world_from_depth, b.rig)
        assert (a.color, a.color_format) == (b.color, b.color_format)
        np.testing.assert_array_equal(a.depth, b.depth, strict=True)
        for x, y in ((a.truth_instances, b.truth_instances), (a.truth_categories, b.truth_categories)):
            assert (x is None) == (y is None)
            if x is not None and y is not None:
                np.testing.assert_array_equal(x, y, strict=True)


def chain_of(frames: list[Frame]) -> str:
    link = START
    for frame in frames:
        link = recording_link(link, frame_digest(frame), frame)
    return link


def two_cameras(frames: list[Frame]) -> list[Frame]:
    """The same pictures, depth cropped to a camera of its own that stands 5 cm beside the colour camera."""
    depth_camera = Intrinsics(20, 10, 20.0, 21.0, 9.5, 4.5)
    rig = Rig(depth_camera, CAMERA, Pose((0.0, 0.0, 0.0, 1.0), (0.05, 0.0, 0.0)))
    return [replace(frame, rig=rig, depth=frame.depth[:10, :20]) for frame in frames]


# What goes in comes out


@pytest.mark.parametrize(
    "frames",
    [
        tiny_frames(3),
        tiny_frames(3, color_format="png"),
        tiny_frames(3, color_format=""),
        tiny_frames(3, truth=False),
        tiny_frames(4, first=5, stride=3),
        two_cameras(tiny_frames(2)),
    ],
    ids=["jpeg", "png", "no colour", "no truth", "numbers with gaps", "two cameras"],
)
def test_frames_and_digest_come_back_exactly(tmp_path: Path, frames: list[Frame]) -> None:
    path = record(tmp_path / "a.mcap", frames)
    read = list(read_frames(path))
    assert_same(read, frames)
    assert recording_info(path).digest == chain_of(read) == chain_of(frames)


finite = st.floats(-1e6, 1e6, allow_nan=False)
unit = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: sum(x * x for x in q) > 0.1)


def normalised(q: tuple[float, ...]) -> tuple[float, float, float, float]:
    length = sum(x * x for x in q) ** 0.5
    return (q[0] / length, q[1] / length, q[2] / length, q[3] / length)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    quaternion=unit.map(normalised),
    translation=st.tuples(finite, finite, finite),
    stamps=st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=1, max_size=4, unique=True).map(sorted),
    depth=arrays(np.uint16, st.tuples(st.integers(1, 5), st.integers(1, 7))),
    focal=st.floats(0.01, 1e6),
)
def test_any_pose_stamp_depth_and_camera_survive_to_the_bit(
    tmp_path: Path,
    quaternion: tuple[float, float, float, float],
    translation: tuple[float, float, float],
    stamps: list[int],
    depth: np.ndarray[Any, np.dtype[np.uint16]],
    focal: float,
) -> None:
    camera = Intrinsics(depth.shape[1], depth.shape[0], focal, focal, 1.5, -0.5)
    pose = Pose(quaternion, translation)
    frames = [Frame(3 * i, stamp, pose, Rig(camera, camera), depth) for i, stamp in enumerate(stamps)]
    path = record(tmp_path / "a.mcap", frames)
    read = list(read_frames(path, ahead=0))
    assert_same(read, frames)
    assert chain_of(read) == chain_of(frames)  # tells 0.0 from -0.0, too


def test_colour_is_decoded_as_rgb_in_colour_pixels(tmp_path: Path) -> None:
    frame = tiny_frames(1, color_format="png")[0]
    color = decode_color(frame)
    assert color.shape == (24, 32, 3)
    assert frame.truth_instances is not None
    assert {tuple(pixel) for pixel in color[frame.truth_instances == 1].tolist()} == {(200, 60, 50)}


def test_info_says_what_was_recorded(tmp_path: Path) -> None:
    frames = tiny_frames(2) + tiny_frames(1, first=9)
    with RecordingWriter(
        tmp_path / "a.mcap", source="scannet", depth_unit="mm", categories=CATEGORIES, extra={"notes": "[]"}
    ) as writer:
        writer.add(frames[0])
        writer.add(frames[1])
        for index in (3, 4, 7):
            writer.drop(index, "pose is not finite")
        writer.add(frames[2])
    info = writer.info()
    assert (info.frames, info.first, info.last, info.source, info.depth_unit) == (3, 0, 9, "scannet", "mm")
    assert info.dropped == {"pose is not finite": 3}
    assert json.loads(info.metadata["dropped"]) == {"pose is not finite": {"count": 3, "ranges": [[3, 4], [7, 7]]}}
    assert info.categories == CATEGORIES
    assert info.rig == frames[0].rig
    assert info.has_color
    assert info.has_truth
    assert info.seconds == pytest.approx(0.9)
    assert info.path_length_m == pytest.approx(0.72)  # the tiny camera walks 8 cm a frame, straight on
    assert info.metadata["notes"] == "[]"


# Bytes


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    first = record(tmp_path / "a.mcap", tiny_frames(12))
    second = record(tmp_path / "b.mcap", tiny_frames(12))
    assert first.read_bytes() == second.read_bytes()


def stock(path: Path) -> Iterator[tuple[str, str, str, Message]]:
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            yield channel.topic, channel.message_encoding, schema.name, message


def test_stock_readers_find_the_topics_of_the_contract(tmp_path: Path) -> None:
    frame = two_cameras(tiny_frames(1))[0]
    messages = {topic: rest for topic, *rest in stock(record(tmp_path / "a.mcap", [frame]))}
    assert {topic: (encoding, schema) for topic, (encoding, schema, _) in messages.items()} == {
        "/camera/color": ("protobuf", "foxglove.CompressedImage"),
        "/camera/color/calibration": ("protobuf", "foxglove.CameraCalibration"),
        "/camera/depth": ("cdr", "sensor_msgs/msg/Image"),
        "/camera/depth/calibration": ("protobuf", "foxglove.CameraCalibration"),
        "/tf": ("protobuf", "foxglove.FrameTransforms"),
        "/truth/instances": ("protobuf", "foxglove.RawImage"),
        "/truth/categories": ("protobuf", "foxglove.RawImage"),
    }
    color = CompressedImage.FromString(messages["/camera/color"][2].data)
    assert (color.data, color.format, color.frame_id) == (frame.color, "jpeg", "camera_color")
    camera = CameraCalibration.FromString(messages["/camera/depth/calibration"][2].data)
    assert (camera.width, camera.height, camera.frame_id) == (20, 10, "camera_depth")
    assert list(camera.K) == [20.0, 0.0, 9.5, 0.0, 21.0, 4.5, 0.0, 0.0, 1.0]
    truth = RawImage.FromString(messages["/truth/instances"][2].data)
    assert (truth.encoding, truth.width, truth.height, truth.step) == ("mono16", 32, 24, 64)
    assert frame.truth_instances is not None
    assert truth.data == frame.truth_instances.astype("<u2").tobytes()


def test_the_transforms_are_the_pose_and_the_rig(tmp_path: Path) -> None:
    frame = two_cameras(tiny_frames(1))[0]
    data = next(m.data for topic, _, _, m in stock(record(tmp_path / "a.mcap", [frame])) if topic == "/tf")
    pose, rig = FrameTransforms.FromString(data).transforms
    assert (pose.parent_frame_id, pose.child_frame_id) == ("world", "camera_depth")
    assert (rig.parent_frame_id, rig.child_frame_id) == ("camera_depth", "camera_color")
    q, t = pose.rotation, pose.translation
    assert ((q.x, q.y, q.z, q.w), (t.x, t.y, t.z)) == (
        frame.world_from_depth.quaternion,
        frame.world_from_depth.translation,
    )
    assert (rig.rotation.w, rig.translation.x) == (1.0, 0.05)
    assert pose.timestamp.ToNanoseconds() == frame.stamp_ns


def test_depth_is_a_ros_image_in_little_endian_cdr(tmp_path: Path) -> None:
    frame = tiny_frames(1)[0]
    data = next(m.data for topic, _, _, m in stock(record(tmp_path / "a.mcap", [frame])) if topic == "/camera/depth")
    # header, stamp, frame id of 13 bytes padded to 16, size, encoding of 6 bytes and endianness padded to 8, step
    assert data[:4] == b"\0\1\0\0"
    assert struct.unpack_from("<iI", data, 4) == (1, 0)
    assert struct.unpack_from("<I13s", data, 12) == (13, b"camera_depth\0")
    assert struct.unpack_from("<II", data, 32) == (24, 32)
    assert struct.unpack_from("<I6sB", data, 40) == (6, b"16UC1\0", 0)
    assert struct.unpack_from("<II", data, 52) == (64, 64 * 24)
    assert data[60:] == frame.depth.astype("<u2").tobytes()


def test_number_and_stamp_of_a_frame_are_on_each_of_its_messages(tmp_path: Path) -> None:
    frames = tiny_frames(3, first=4, stride=5)
    path = record(tmp_path / "a.mcap", frames)
    keys = {(m.sequence, m.log_time, m.publish_time) for _, _, _, m in stock(path)}
    assert keys == {(frame.index, frame.stamp_ns, frame.stamp_ns) for frame in frames}


def chunk_indexes(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return summary.chunk_indexes


def test_chunks_close_after_a_second_of_log_time(tmp_path: Path) -> None:
    chunks = chunk_indexes(record(tmp_path / "a.mcap", tiny_frames(25)))
    assert [(c.message_end_time - c.message_start_time) // 10**8 for c in chunks] == [9, 9, 4]
    assert {c.compression for c in chunks} == {"zstd"}


def test_chunks_close_at_a_mebibyte(tmp_path: Path) -> None:
    topic = Topic("/noise", "json", "", "", b"")
    with McapWriter(tmp_path / "a.mcap") as writer:
        for i in range(10):
            writer.add(topic, i, i, bytes(400_000))
    assert [c.uncompressed_size // 400_000 for c in chunk_indexes(tmp_path / "a.mcap")] == [3, 3, 3, 1]


def test_rerun_sees_colour_on_a_frustum_and_depth_as_depth(tmp_path: Path) -> None:
    from rerun.chunk import McapReader

    path = record(tmp_path / "a.mcap", tiny_frames(2))
    components: dict[str, set[str]] = {}
    values: dict[str, Any] = {}
    for chunk in McapReader(str(path)).stream():
        batch = chunk.to_record_batch()
        components.setdefault(chunk.entity_path, set()).update(batch.schema.names)
        for name in batch.schema.names:
            values.setdefault(f"{chunk.entity_path} {name}", batch.column(name).to_pylist() if ":" in name else None)
    assert {"EncodedImage:blob", "EncodedImage:media_type"} <= components["/camera/color"]
    assert {"DepthImage:buffer", "DepthImage:format"} <= components["/camera/depth"]
    assert {"Transform3D:quaternion", "Transform3D:translation"} <= components["/tf"]
    assert "Image:buffer" in components["/truth/instances"]
    for camera in ("color", "depth"):
        assert "Pinhole:image_from_camera" in components[f"/camera/{camera}/calibration"]
        plane = values[f"/camera/{camera}/calibration Pinhole:child_frame"][0]
        assert values[f"/camera/{camera} CoordinateFrame:frame"][0] == plane == [f"camera_{camera}_image_plane"]
        assert values[f"/camera/{camera}/calibration Pinhole:parent_frame"][0] == [f"camera_{camera}"]


# Selection


def test_start_end_and_stride_mean_frame_numbers(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", tiny_frames(10, first=1, stride=2))  # 1, 3, ... 19
    assert [f.index for f in read_frames(path, start=4, end=13)] == [5, 7, 9, 11]
    assert [f.index for f in read_frames(path, start=3, stride=4)] == [3, 7, 11, 15, 19]
    assert [f.index for f in read_frames(path, stride=3)] == [3, 9, 15]
    assert list(read_frames(path, start=20)) == []
    with pytest.raises(InputError, match="stride is 0"):
        read_frames(path, stride=0)


def test_frames_from_any_start_on_are_the_same_as_without_it(tmp_path: Path) -> None:
    frames = tiny_frames(35)  # four chunks
    path = record(tmp_path / "a.mcap", frames)
    for start in range(0, 36, 7):
        assert_same(list(read_frames(path, start=start)), frames[start:])


def test_chunks_before_the_start_are_not_read(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", tiny_frames(35))
    data = bytearray(path.read_bytes())
    data[chunk_indexes(path)[1].chunk_start_offset + 3000] ^= 1
    path.write_bytes(data)
    assert [f.index for f in read_frames(path, start=21)] == list(range(21, 35))
    with pytest.raises(InputError, match="damaged"):
        list(read_frames(path, start=15))


def test_truth_is_left_out_on_request(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", tiny_frames(2))
    assert all(f.truth_instances is None and f.truth_categories is None for f in read_frames(path, truth=False))


# Reading ahead


def reader_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "openvox read ahead"]


def test_the_reading_thread_ends_when_the_frames_are_used_up(tmp_path: Path) -> None:
    list(read_frames(record(tmp_path / "a.mcap", tiny_frames(3))))
    assert reader_threads() == []


@pytest.mark.parametrize("ahead", [1, 2, 8])
def test_the_reading_thread_ends_when_the_frames_are_abandoned(tmp_path: Path, ahead: int) -> None:
    frames = read_frames(record(tmp_path / "a.mcap", tiny_frames(20)), ahead=ahead)
    next(frames)
    frames.close()
    assert reader_threads() == []
    forgotten = read_frames(tmp_path / "a.mcap", ahead=ahead)
    next(forgotten)
    del forgotten
    gc.collect()
    assert reader_threads() == []


def test_reading_ahead_is_bounded() -> None:
    made: list[int] = []

    def items() -> Iterator[int]:
        for i in range(100):
            made.append(i)
            yield i

    ahead = read_ahead(items(), 3)
    for used in range(5):
        next(ahead)
        time.sleep(0.01)
        assert len(made) <= used + 1 + 3 + 1  # used, in the queue, in the thread's hand
    ahead.close()
    assert len(made) < 100


def test_an_error_while_reading_ahead_is_raised_after_the_items_before_it() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise InputError("broken")

    ahead = read_ahead(items(), 4)
    assert next(ahead) == 1
    with pytest.raises(InputError, match="broken"):
        next(ahead)
    assert reader_threads() == []


def peak_while_reading(path: Path) -> int:
    tracemalloc.start()
    for _ in read_frames(path, ahead=2):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_memory_does_not_grow_with_the_length(tmp_path: Path) -> None:
    camera = Intrinsics(320, 240, 260.0, 260.0, 159.5, 119.5)
    frame = tiny_frames(1, camera=camera)[0]
    paths = {}
    for count in (10, 60):
        frames = [replace(frame, index=i, stamp_ns=i * 10**8) for i in range(count)]
        paths[count] = tmp_path / f"{count}.mcap"
        tracemalloc.start()
        record(paths[count], frames)
        assert tracemalloc.get_traced_memory()[1] < 8_000_000
        tracemalloc.stop()
    short, long = peak_while_reading(paths[10]), peak_while_reading(paths[60])
    assert long < 1.5 * short


# What a writer refuses


def add_all(path: Path, frames: list[Frame]) -> None:
    path.write_bytes(b"older")
    record(path, frames)


def test_a_writer_refuses_what_cannot_follow_and_leaves_the_older_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    a, b = tiny_frames(2)
    cases = {
        "frame 0 follows frame 1; frame numbers must rise": [b, a],
        "frame 0 follows frame 0": [a, a],
        "frame 1: stamp 1000000000 ns comes not after": [a, replace(b, stamp_ns=a.stamp_ns)],
        "stamp -1 ns; expected seconds between": [replace(a, stamp_ns=-1)],
        "frame 0: colour is a jpeg of 32x24; its camera says png": [replace(a, color_format="png")],
        "frame 0, colour: the picture begins with 6e6f": [replace(a, color=b"no picture")],
        "there is no frame to record": [],
    }
    for sentence, frames in cases.items():
        with pytest.raises(InputError, match=sentence):
            add_all(path, frames)
        assert path.read_bytes() == b"older"
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here to play the full disk")
def test_a_full_disk_leaves_the_older_recording(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", tiny_frames(1))
    before = path.read_bytes()
    (tmp_path / "a.mcap.partial").symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"a\.mcap could not be written \(No space left on device\)"):
        record(path, tiny_frames(3))
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_messages_of_a_topic_can_be_read_alone(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", tiny_frames(3))
    assert [(m.topic, m.sequence) for m in read_messages(path, {"/tf"})] == [("/tf", 0), ("/tf", 1), ("/tf", 2)]


def test_pictures_encoded_here_are_read_back() -> None:
    depth = tiny_frames(1)[0].depth
    np.testing.assert_array_equal(decode_png16(encode_png(depth)), depth, strict=True)
    color = np.zeros((24, 32, 3), np.uint8)
    color[..., 0] = 200
    frame = replace(tiny_frames(1)[0], color=encode_jpeg(color), color_format="jpeg")
    np.testing.assert_allclose(decode_color(frame).astype(int), color.astype(int), atol=3)
