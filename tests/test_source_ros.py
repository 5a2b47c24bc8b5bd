"""ROS bags: frames come out as the robot saw them, whatever the storage; what cannot be used is counted."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bags import COLOR, DEPTH, MOUNT, OPTICAL, Message, Messages, pictures, rgb_of, robot, write_bag
from numpy.typing import NDArray
from worlds import CAMERA, look_at, tiny_frames

from openvox.apps.ingest import IngestResult, ingest
from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics, Pose, Rig
from openvox.formats.recording import read_frames, recording_info
from openvox.formats.robot_log import Calibration, Item, Log, Picture, Transform
from openvox.sources import Dropped, Options
from openvox.sources.log_frames import read
from openvox.sources.log_pictures import Camera
from openvox.sources.transforms import Track, Tree, between, compose, inverse

MAKE = Messages()
FRAMES = tiny_frames(5, truth=False)
MS = 1_000_000


def bag(folder: Path, messages: list[Message], storage: str = "mcap", make: Messages = MAKE) -> Path:
    return write_bag(folder / ("bag.bag" if make.ros1 else "bag"), make, messages, storage)


def ingested(folder: Path, messages: list[Message], **options: Any) -> tuple[IngestResult, list[Frame]]:
    """A bag of the messages by way of a recording."""
    result = ingest(bag(folder, messages), folder / "out.mcap", **options)
    return result, list(read_frames(folder / "out.mcap"))


def refusal(folder: Path, messages: list[Message], **options: Any) -> str:
    with pytest.raises(InputError) as refused:
        ingest(bag(folder, messages), folder / "out.mcap", **options)
    assert not list(folder.glob("out.mcap*"))
    assert "\n" not in str(refused.value)
    return str(refused.value)


def usual(frames: list[Frame] = FRAMES) -> list[Message]:
    return [*robot(MAKE, frames), *pictures(MAKE, frames)]


def without(messages: list[Message], *topics: str) -> list[Message]:
    return [one for one in messages if one[0] not in topics]


@pytest.mark.parametrize(("ros1", "storage"), [(False, "mcap"), (False, "sqlite"), (True, "")])
def test_a_bag_of_any_storage_gives_the_frames_that_the_robot_saw(tmp_path: Path, ros1: bool, storage: str) -> None:
    make = Messages(ros1)
    path = bag(tmp_path, [*robot(make, FRAMES), *pictures(make, FRAMES)], storage, make)
    result = ingest(path, tmp_path / "out.mcap")
    for actual, frame in zip(read_frames(tmp_path / "out.mcap"), FRAMES, strict=True):
        assert (actual.index, actual.stamp_ns, actual.color, actual.rig) == (
            frame.index,
            frame.stamp_ns,
            frame.color,
            frame.rig,
        )
        np.testing.assert_array_equal(actual.depth, frame.depth)
        np.testing.assert_allclose(actual.world_from_depth.matrix(), frame.world_from_depth.matrix(), atol=1e-14)
    assert result.source == ("ros1" if ros1 else "ros2")
    assert (result.dropped, result.notes) == (
        {},
        (f"colour from {COLOR}/compressed, depth from {DEPTH}", f"poses are those of {OPTICAL} in map"),
    )


def test_transforms_of_the_first_days_of_ros_are_read_too(tmp_path: Path) -> None:
    make = Messages(ros1=True, old_tf=True)
    path = bag(tmp_path, [*robot(make, FRAMES), *pictures(make, FRAMES)], make=make)
    assert ingest(path, tmp_path / "out.mcap").frames == 5


@pytest.mark.parametrize("suffix", ["*.mcap", "*.db3"])
def test_a_bags_file_without_its_folder_is_read_too(tmp_path: Path, suffix: str) -> None:
    path = bag(tmp_path, usual(), "mcap" if suffix == "*.mcap" else "sqlite")
    assert ingest(next(path.glob(suffix)), tmp_path / "out.mcap").frames == 5


# Pictures


def as_encoding(rgb: NDArray[np.uint8], encoding: str) -> NDArray[np.uint8]:
    alpha = np.full((*rgb.shape[:2], 1), 255, np.uint8)
    return {
        "rgb8": rgb,
        "bgr8": rgb[..., ::-1],
        "rgba8": np.concatenate([rgb, alpha], 2),
        "bgra8": np.concatenate([rgb[..., ::-1], alpha], 2),
        "mono8": rgb[..., 1],
    }[encoding]


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "rgba8", "bgra8", "mono8"])
def test_raw_colour_is_stored_without_loss(tmp_path: Path, encoding: str) -> None:
    messages = without(usual(), f"{COLOR}/compressed")
    for frame in FRAMES:
        image = as_encoding(rgb_of(frame), encoding)
        messages.append((COLOR, frame.stamp_ns, MAKE.image(frame.stamp_ns, image, encoding)))
    result, frames = ingested(tmp_path, messages)
    expected = rgb_of(FRAMES[2])
    if encoding == "mono8":
        expected = np.repeat(expected[..., 1:2], 3, 2)
    assert frames[2].color_format == "png"
    np.testing.assert_array_equal(rgb_of(frames[2]), expected)
    assert any(note.startswith("colour was stored as PNG") for note in result.notes)


@pytest.mark.parametrize("big", [False, True])
def test_metres_become_millimetres_half_to_even_and_what_is_no_length_becomes_nothing(
    tmp_path: Path, big: bool
) -> None:
    metres = np.zeros((24, 32), np.float32)
    metres[0, :9] = [np.nan, np.inf, -1.0, 0.0, 0.0005, 0.0015, 2.0, 65.535, 65.536]
    messages = without(usual(), DEPTH)
    messages += [(DEPTH, f.stamp_ns, MAKE.image(f.stamp_ns, metres, "32FC1", big=big)) for f in FRAMES]
    result, frames = ingested(tmp_path, messages)
    # 0.0005 and 0.0015 as float32 lie a little above and below the half
    assert frames[0].depth[0, :9].tolist() == [0, 0, 0, 0, 1, 2, 2000, 65535, 0]
    assert recording_info(tmp_path / "out.mcap").depth_unit == "m"
    assert "depth in metres was rounded to millimetres, half to even" in result.notes


def test_compressed_depth_is_read_behind_its_header(tmp_path: Path) -> None:
    messages = without(usual(), DEPTH)
    for frame in FRAMES:
        data = struct.pack("<iff", 0, 0.0, 0.0) + cv2.imencode(".png", frame.depth)[1].tobytes()
        packed = MAKE.compressed(frame.stamp_ns, data, "16UC1; compressedDepth png")
        messages.append((f"{DEPTH}/compressedDepth", frame.stamp_ns, packed))
    _, frames = ingested(tmp_path, messages)
    np.testing.assert_array_equal(frames[3].depth, FRAMES[3].depth)


def test_compressed_depth_in_metres_is_inverse_depth(tmp_path: Path) -> None:
    raw = np.zeros((24, 32), np.uint16)
    raw[0, :3] = [0, 150, 300]
    messages = without(usual(), DEPTH)
    for frame in FRAMES:
        data = struct.pack("<iff", 0, 200.0, 50.0) + cv2.imencode(".png", raw)[1].tobytes()
        packed = MAKE.compressed(frame.stamp_ns, data, "32FC1; compressedDepth")
        messages.append((f"{DEPTH}/compressedDepth", frame.stamp_ns, packed))
    _, frames = ingested(tmp_path, messages)
    assert frames[0].depth[0, :3].tolist() == [0, 2000, 800]  # 200 / (150 - 50), 200 / (300 - 50)


def test_a_lens_that_distorts_is_rectified_once_and_said(tmp_path: Path) -> None:
    """A bright dot is drawn where the lens puts it, and found where a pinhole would."""
    lens, k = np.array([-0.25, 0.05, 0.0, 0.0, 0.0]), np.array([[260.0, 0, 159.5], [0, 260.0, 119.5], [0, 0, 1]])
    camera, ideal = Intrinsics(320, 240, 260.0, 260.0, 159.5, 119.5), (265, 40)
    ray = np.array([[(ideal[0] - 159.5) / 260.0, (ideal[1] - 119.5) / 260.0, 1.0]])
    bent = cv2.projectPoints(ray, np.zeros(3), np.zeros(3), k, lens)[0].ravel()
    image, depth = np.zeros((240, 320, 3), np.uint8), np.full((240, 320), 1000, np.uint16)
    x, y = round(float(bent[0])), round(float(bent[1]))
    image[y - 2 : y + 3, x - 2 : x + 3], depth[y - 2 : y + 3, x - 2 : x + 3] = 255, 2000
    messages = [one for one in usual() if one[0].startswith("/tf")]
    for frame in FRAMES:
        stamp = frame.stamp_ns
        messages += [
            (COLOR, stamp, MAKE.image(stamp, image, "rgb8")),
            (DEPTH, stamp, MAKE.image(stamp, depth, "16UC1")),
            (COLOR.replace("image_raw", "camera_info"), stamp, MAKE.info(stamp, camera, tuple(lens))),
            (DEPTH.replace("image_raw", "camera_info"), stamp, MAKE.info(stamp, camera, tuple(lens))),
        ]
    result, frames = ingested(tmp_path, messages)
    for found in (rgb_of(frames[0])[..., 0] > 128, frames[0].depth == 2000):
        rows, columns = np.nonzero(found)
        np.testing.assert_allclose([columns.mean(), rows.mean()], ideal, atol=0.7)
    assert abs(bent[0] - ideal[0]) > 5  # the test would see it if nothing were done
    assert set(np.unique(frames[0].depth)) <= {0, 1000, 2000}  # no depth is made up between two
    assert "colour was rectified: its lens distorts (plumb_bob)" in result.notes


def test_a_picture_of_another_size_than_its_camera_is_not_rectified() -> None:
    k = (30.0, 0.0, 16.0, 0.0, 30.0, 12.0, 0.0, 0.0, 1.0)
    camera = Camera.of(Calibration("", 32, 24, k, (0.1, 0.0, 0.0, 0.0), "plumb_bob", ()), (32, 24), rectified=False)
    assert camera.rectify(np.zeros((24, 32, 3), np.uint8)).shape == (24, 32, 3)
    with pytest.raises(InputError, match="the picture is 64x48 pixels, its camera 32x24"):
        camera.rectify(np.zeros((48, 64, 3), np.uint8))


def test_pictures_of_a_rectified_topic_keep_their_pixels_and_have_the_camera_p(tmp_path: Path) -> None:
    messages = []
    for topic, time, message in usual():
        if topic.endswith("camera_info"):
            message = MAKE.info(message.header.stamp.sec * 10**9, CAMERA, (0.1, 0.0, 0.0, 0.0, 0.0))
            message.p[0] = message.p[5] = 20.0
        messages.append((topic.replace("image_raw", "image_rect"), time, message))
    _, frames = ingested(tmp_path, messages)
    assert frames[0].rig.color == replace(CAMERA, fx=20.0, fy=20.0)
    assert frames[0].color == FRAMES[0].color


# Poses


def test_poses_between_two_transforms_lie_in_between() -> None:
    s = np.sqrt(0.5)
    a, b = Pose((0.0, 0.0, 0.0, 1.0), (0.0, 2.0, 0.0)), Pose((0.0, 0.0, s, s), (4.0, 2.0, 0.0))
    half = between(a, b, 0.25)
    assert half.translation == (1.0, 2.0, 0.0)
    np.testing.assert_allclose(half.quaternion, (0, 0, np.sin(np.pi / 16), np.cos(np.pi / 16)))
    other = Pose((0.0, 0.0, -s, -s), b.translation)  # the same rotation; the arc must not get longer
    np.testing.assert_allclose(abs(np.dot(between(a, other, 0.5).quaternion, between(a, b, 0.5).quaternion)), 1.0)


def test_composing_and_inverting_are_those_of_matrices() -> None:
    a, b = look_at((0.3, -1.0, 0.5), (1.0, 2.0, 0.0)), look_at((-2.0, 0.1, 1.0), (1.0, 1.0, 0.4))
    np.testing.assert_allclose(compose(a, b).matrix(), a.matrix() @ b.matrix(), atol=1e-14)
    np.testing.assert_allclose(inverse(a).matrix(), np.linalg.inv(a.matrix()), atol=1e-14)


def test_stamps_of_pictures_need_not_be_those_of_transforms(tmp_path: Path) -> None:
    """The robot drives straight at constant speed, so that every pose in between is known."""
    frames = [replace(frame, stamp_ns=frame.stamp_ns + 37 * MS) for frame in FRAMES[:-1]]
    way = [Pose((0.0, 0.0, 0.0, 1.0), (0.5 * i, 0.0, 0.0)) for i in range(5)]
    still = Pose.identity()
    messages = [*pictures(MAKE, frames), ("/tf_static", 0, MAKE.tf(0, "base", OPTICAL, MOUNT))]
    messages += [
        ("/tf", frame.stamp_ns + 20 * MS, MAKE.tf(frame.stamp_ns, "odom", "base", pose))
        for frame, pose in zip(FRAMES, way, strict=True)
    ]
    _, found = ingested(tmp_path, messages)
    expected = compose(Pose(still.quaternion, (0.5 + 0.185, 0.0, 0.0)), MOUNT)
    np.testing.assert_allclose(found[1].world_from_depth.matrix(), expected.matrix(), atol=1e-12)
    assert len(found) == 4


def test_a_gap_in_the_transforms_is_not_bridged_unless_asked_for(tmp_path: Path) -> None:
    messages = [
        one for one in usual() if not (one[0] == "/tf" and one[1] in {f.stamp_ns + 9 * MS for f in FRAMES[1:4]})
    ]
    result, frames = ingested(tmp_path, messages)
    assert [frame.index for frame in frames] == [0, 4]
    assert result.dropped == {"transform map <- odom has a gap of more than 0.2 s": 3} or result.dropped == {
        "transform odom <- base_link has a gap of more than 0.2 s": 3
    }
    assert ingest(tmp_path / "bag", tmp_path / "out.mcap", max_gap=0.5).frames == 5


def test_frames_outside_of_the_transforms_are_counted_by_reason(tmp_path: Path) -> None:
    ends = {FRAMES[0].stamp_ns + 9 * MS, FRAMES[4].stamp_ns + 9 * MS}
    result, frames = ingested(tmp_path, [one for one in usual() if not (one[0] == "/tf" and one[1] in ends)])
    assert [frame.index for frame in frames] == [1, 2, 3]
    assert {reason.rpartition(" ")[2]: count for reason, count in result.dropped.items()} == {"later": 1, "before": 1}


def test_without_transforms_to_the_camera_one_sentence_names_what_is_there(tmp_path: Path) -> None:
    text = refusal(tmp_path, without(usual(), "/tf", "/tf_static"))
    assert f"no transform of the camera's frame '{OPTICAL}'" in text
    assert "--poses TRAJECTORY" in text


def test_the_world_and_the_camera_can_be_named(tmp_path: Path) -> None:
    odom = Pose((0.0, 0.0, 0.0, 1.0), (5.0, -2.0, 0.0))
    _, frames = ingested(tmp_path, usual(), world="odom", camera="base_link")
    expected = compose(inverse(odom), compose(FRAMES[1].world_from_depth, inverse(MOUNT)))
    np.testing.assert_allclose(frames[1].world_from_depth.matrix(), expected.matrix(), atol=1e-12)


def odometry(kind: str) -> list[Message]:
    make = MAKE
    out: list[Message] = [("/tf_static", 0, make.tf(0, "base_link", OPTICAL, MOUNT))]
    for frame in FRAMES:
        base = compose(frame.world_from_depth, inverse(MOUNT))
        message = (
            make.odometry(frame.stamp_ns, "odom", "base_link", base)
            if kind == "odometry"
            else make.pose_stamped(frame.stamp_ns, "map", frame.world_from_depth)
        )
        out.append(("/where", frame.stamp_ns + MS, message))
    return out


@pytest.mark.parametrize("kind", ["odometry", "pose"])
def test_odometry_moves_the_body_and_a_stamped_pose_the_camera(tmp_path: Path, kind: str) -> None:
    _, frames = ingested(tmp_path, [*odometry(kind), *pictures(MAKE, FRAMES)])
    for actual, frame in zip(frames, FRAMES, strict=True):
        np.testing.assert_allclose(actual.world_from_depth.matrix(), frame.world_from_depth.matrix(), atol=1e-12)


def test_odometry_of_a_body_without_camera_asks_for_the_extrinsic(tmp_path: Path) -> None:
    messages = [*without(odometry("odometry"), "/tf_static"), *pictures(MAKE, FRAMES)]
    assert "give --extrinsic FILE" in refusal(tmp_path, messages)
    np.savetxt(tmp_path / "mount.txt", MOUNT.matrix())
    options = {"extrinsic": tmp_path / "mount.txt", "topics": {"pose": "/where"}}
    ingest(tmp_path / "bag", tmp_path / "out.mcap", **options)
    actual = next(read_frames(tmp_path / "out.mcap"))
    np.testing.assert_allclose(actual.world_from_depth.matrix(), FRAMES[0].world_from_depth.matrix(), atol=1e-12)


def test_a_chosen_pose_topic_goes_before_the_transforms_of_its_body(tmp_path: Path) -> None:
    far = Pose((0.0, 0.0, 0.0, 1.0), (100.0, 0.0, 0.0))
    wrong = [("/tf", f.stamp_ns, MAKE.tf(f.stamp_ns, "odom", "base_link", far)) for f in FRAMES]
    messages = [*odometry("odometry"), *wrong, *pictures(MAKE, FRAMES)]
    _, frames = ingested(tmp_path, messages, topics={"pose": "/where"})
    np.testing.assert_allclose(frames[2].world_from_depth.matrix(), FRAMES[2].world_from_depth.matrix(), atol=1e-12)


def test_poses_of_another_program_replace_those_of_the_bag(tmp_path: Path) -> None:
    lines = ["# stamp x y z qx qy qz qw"]
    for frame in FRAMES[:4]:
        body = compose(frame.world_from_depth, inverse(MOUNT))
        lines.append(" ".join(repr(v) for v in (frame.stamp_ns / 1e9, *body.translation, *body.quaternion)))
    (tmp_path / "slam.txt").write_text("\n".join(lines))
    np.savetxt(tmp_path / "mount.txt", MOUNT.matrix())
    result, frames = ingested(
        tmp_path, pictures_only(), poses=tmp_path / "slam.txt", extrinsic=tmp_path / "mount.txt", origin=(0, 0, 1)
    )
    assert result.dropped == {"the trajectory ends before": 1}
    expected = FRAMES[3].world_from_depth.matrix()
    expected[2, 3] -= 1
    np.testing.assert_allclose(frames[3].world_from_depth.matrix(), expected, atol=1e-12)


def pictures_only() -> list[Message]:
    return list(pictures(MAKE, FRAMES))


# Colour beside depth


def beside(shift: Pose) -> list[Message]:
    """The usual bag, but depth is seen from a frame of its own."""
    frame_id = "camera_depth_optical_frame"
    messages = [one for one in usual() if not one[0].startswith("/camera/aligned")]
    messages.append(("/tf_static", 0, MAKE.tf(0, OPTICAL, frame_id, shift)))
    for frame in FRAMES:
        stamp = frame.stamp_ns
        messages.append(("/camera/depth/image_raw", stamp, MAKE.image(stamp, frame.depth, "16UC1", frame_id)))
        messages.append(("/camera/depth/camera_info", stamp, MAKE.info(stamp, CAMERA, frame=frame_id)))
    return messages


def test_depth_of_another_camera_takes_its_place_from_the_transforms(tmp_path: Path) -> None:
    shift = Pose((0.0, 0.0, 0.0, 1.0), (0.025, 0.0, 0.0))
    _, frames = ingested(tmp_path, beside(shift))
    assert frames[0].rig == Rig(CAMERA, CAMERA, Pose((0.0, 0.0, 0.0, 1.0), (-0.025, 0.0, 0.0)))
    expected = compose(FRAMES[2].world_from_depth, shift)
    np.testing.assert_allclose(frames[2].world_from_depth.matrix(), expected.matrix(), atol=1e-12)


def test_where_no_transform_says_where_depth_sits_a_matrix_can(tmp_path: Path) -> None:
    messages = [one for one in beside(Pose.identity()) if not (one[0] == "/tf_static" and one[1] == 0)]
    assert "give --color-from-depth FILE" in refusal(tmp_path, messages)
    np.savetxt(tmp_path / "between.txt", Pose((0.0, 0.0, 0.0, 1.0), (0.5, 0.0, 0.0)).matrix())
    options = {"color_from_depth": tmp_path / "between.txt", "camera": OPTICAL}
    ingest(tmp_path / "bag", tmp_path / "out.mcap", **options)
    frame = next(read_frames(tmp_path / "out.mcap"))
    assert frame.rig.depth_from_color.translation == (-0.5, 0.0, 0.0)
    # the transforms tell where the colour camera is; the depth camera is half a metre to its right
    expected = compose(FRAMES[0].world_from_depth, Pose((0.0, 0.0, 0.0, 1.0), (0.5, 0.0, 0.0)))
    np.testing.assert_allclose(frame.world_from_depth.matrix(), expected.matrix(), atol=1e-12)


# Stamps


def test_colour_and_depth_are_one_frame_within_the_tolerance_only(tmp_path: Path) -> None:
    late = {1: 4 * MS, 2: 30 * MS}
    messages = without(usual(), f"{COLOR}/compressed")
    for frame in FRAMES:
        stamp = frame.stamp_ns + late.get(frame.index, 0)
        messages.append((f"{COLOR}/compressed", stamp, MAKE.compressed(stamp, frame.color, "jpeg")))
    result, frames = ingested(tmp_path, messages)
    assert [frame.index for frame in frames] == [0, 1, 3, 4]
    assert result.dropped == {"no colour within 20 ms": 1}
    assert ingest(tmp_path / "bag", tmp_path / "out.mcap", tolerance=0.03).frames == 5
    assert ingest(tmp_path / "bag", tmp_path / "out.mcap", tolerance=0.003).frames == 3


def test_repeated_and_backward_stamps_are_left_out_and_counted(tmp_path: Path) -> None:
    messages = usual()
    again, back = FRAMES[1].stamp_ns, FRAMES[0].stamp_ns - 500 * MS
    messages.append((DEPTH, FRAMES[1].stamp_ns + 6 * MS, MAKE.image(again, FRAMES[1].depth, "16UC1")))
    messages.append((DEPTH, FRAMES[3].stamp_ns + 6 * MS, MAKE.image(back, FRAMES[1].depth, "16UC1")))
    result, frames = ingested(tmp_path, messages)
    assert [frame.index for frame in frames] == [0, 1, 3, 4, 6]
    assert result.dropped == {
        "a stamp that was there already": 1,
        "a stamp before that of the frame before (the clock went back, or messages are out of order)": 1,
    }


def test_a_clock_that_jumps_forward_is_said(tmp_path: Path) -> None:
    later = [replace(frame, stamp_ns=frame.stamp_ns + (3600 * 10**9 if i > 2 else 0)) for i, frame in enumerate(FRAMES)]
    messages = [(topic, time - (3600 * 10**9 if time > 3600 * 10**9 else 0), m) for topic, time, m in usual(later)]
    result, frames = ingested(tmp_path, messages)
    assert len(frames) == 5
    assert "1 times the clock jumped forward by more than a second" in result.notes


def test_transforms_out_of_order_and_repeated_are_put_right_and_counted() -> None:
    track = Track()
    for second in (0, 2, 1, 2):
        track.add(second * 10**9, Pose((0.0, 0.0, 0.0, 1.0), (float(second), 0.0, 0.0)))
    at = track.at(1_500_000_000, 10**9)
    assert isinstance(at, Pose)
    assert at.translation == (1.5, 0.0, 0.0)
    assert (track.disordered, track.repeated) == (1, 1)


def test_frames_that_go_in_a_circle_end_the_search() -> None:
    tree = Tree(10**9)
    for parent, child in (("a", "b"), ("b", "a")):
        tree.add(Transform(0, parent, child, Pose.identity(), static=True))
    assert tree.lookup("map", "a", 0) == "no transform of a in map"


def test_start_end_and_stride_count_depth_pictures(tmp_path: Path) -> None:
    _, frames = ingested(tmp_path, usual(), start=1, end=5, stride=2)
    assert [frame.index for frame in frames] == [1, 3]


# Topics


def test_several_cameras_are_listed_and_one_can_be_chosen(tmp_path: Path) -> None:
    rear = [(topic.replace("/camera/", "/rear/"), time, message) for topic, time, message in pictures(MAKE, FRAMES)]
    text = refusal(tmp_path, [*usual(), *rear])
    for topic in (COLOR, DEPTH):
        assert topic in text
        assert topic.replace("/camera/", "/rear/") in text
    assert "--topic color=NAME --topic depth=NAME" in text
    topics = {
        "color": f"{COLOR}/compressed".replace("/camera/", "/rear/"),
        "depth": DEPTH.replace("/camera/", "/rear/"),
    }
    result = ingest(tmp_path / "bag", tmp_path / "out.mcap", topics=topics)
    assert result.notes[0] == f"colour from {topics['color']}, depth from {topics['depth']}"
    for wrong, words in (({"color": "/none"}, "there is no topic /none"), ({"hue": COLOR}, "expected one of color")):
        with pytest.raises(InputError, match=words):
            ingest(tmp_path / "bag", tmp_path / "out.mcap", topics=wrong)


def test_infrared_beside_colour_is_no_second_camera(tmp_path: Path) -> None:
    grey = np.zeros((24, 32), np.uint8)
    infrared = [("/camera/infra1/image_rect_raw", f.stamp_ns, MAKE.image(f.stamp_ns, grey, "mono8")) for f in FRAMES]
    result, _ = ingested(tmp_path, [*usual(), *infrared])
    assert f"colour from {COLOR}/compressed" in result.notes[0]


def test_a_bag_without_depth_or_calibration_is_one_sentence(tmp_path: Path) -> None:
    assert "has no depth pictures" in refusal(tmp_path, without(usual(), DEPTH))
    (tmp_path / "other").mkdir()
    infos = (COLOR.replace("image_raw", "camera_info"), DEPTH.replace("image_raw", "camera_info"))
    assert "no calibration belongs to" in refusal(tmp_path / "other", without(usual(), *infos))


def test_a_bag_without_colour_is_recorded_without_and_one_in_a_strange_encoding_is_refused(tmp_path: Path) -> None:
    bare = without(usual(), f"{COLOR}/compressed")
    result, frames = ingested(tmp_path, bare)
    assert (len(frames), frames[0].color) == (5, b"")
    assert result.notes[0] == f"colour from no topic, depth from {DEPTH}"
    (tmp_path / "other").mkdir()
    strange = np.zeros((24, 32, 2), np.uint8)
    bare += [(COLOR, f.stamp_ns, MAKE.image(f.stamp_ns, strange, "yuv422_yuy2")) for f in FRAMES]
    assert f"{COLOR} is 'yuv422_yuy2', which is not read" in refusal(tmp_path / "other", bare)


# Bad bags


def test_a_broken_bag_is_one_sentence(tmp_path: Path) -> None:
    path = next(bag(tmp_path, usual()).glob("*.mcap"))
    whole = path.read_bytes()
    for data in (
        whole[: len(whole) // 2],
        whole[:60],
        whole[:-20] + bytes(20),
        whole[:2000] + bytes(2000) + whole[4000:],
    ):
        path.write_bytes(data)
        with pytest.raises(InputError) as refused:
            ingest(path, tmp_path / "out.mcap", format="ros")
        assert "\n" not in str(refused.value)
        assert not list(tmp_path.glob("out.mcap*"))


def test_one_picture_that_cannot_be_decoded_costs_one_frame(tmp_path: Path) -> None:
    messages = without(usual(), f"{COLOR}/compressed")
    for frame in FRAMES:
        data = frame.color[:-9] if frame.index == 2 else frame.color
        messages.append((f"{COLOR}/compressed", frame.stamp_ns, MAKE.compressed(frame.stamp_ns, data, "jpeg")))
    result, _ = ingested(tmp_path, messages)
    assert result.dropped == {"a picture that cannot be decoded": 1}


@pytest.mark.parametrize(("width", "height", "step"), [(32, 24, 8), (40000, 24, 80000), (32, 25, 64), (0, 0, 0)])
def test_sizes_that_a_picture_only_claims_are_refused(tmp_path: Path, width: int, height: int, step: int) -> None:
    messages = without(usual(), DEPTH)
    for frame in FRAMES:
        message = MAKE.image(frame.stamp_ns, frame.depth, "16UC1")
        message.width, message.height, message.step = width, height, step
        messages.append((DEPTH, frame.stamp_ns, message))
    assert DEPTH in refusal(tmp_path, messages)


def test_poses_that_are_none_are_passed_over(tmp_path: Path) -> None:
    zero = MAKE.odometry(FRAMES[0].stamp_ns - MS, "odom", "base_link", Pose.identity())
    zero.pose.pose.orientation.w = 0.0
    messages = [*odometry("odometry"), ("/where", FRAMES[0].stamp_ns - MS, zero), *pictures(MAKE, FRAMES)]
    assert ingested(tmp_path, messages)[0].frames == 5


def test_what_is_held_does_not_grow_with_the_log() -> None:
    """A log of 3000 frames whose transforms come two seconds late: never more than so many pictures wait."""
    alive, most = 0, 0

    def messages(names: Collection[str]) -> Iterator[tuple[int, str, Item]]:
        nonlocal alive, most
        info = Calibration("cam", 4, 3, (4.0, 0, 1.5, 0, 4.0, 1.0, 0, 0, 1), (), "", ())
        yield 0, "/depth/camera_info", info
        for i in range(3000):
            now = i * 33 * MS
            alive, most = alive + 1, max(most, alive)
            yield now, "/depth/image", Picture(now, "cam", "16UC1", b"\1\0" * 12, 4, 3, 8)
            pose = Pose((0.0, 0.0, 0.0, 1.0), (float(i), 0.0, 0.0))
            yield now, "/tf", (Transform(max(0, now - 2000 * MS), "map", "cam", pose),)

    log = Log(
        Path("log"),
        "test",
        {"/depth/image": "image", "/depth/camera_info": "calibration", "/tf": "transforms"},
        messages,
    )
    source = read(log, Options())
    alive = most = count = 0
    for frame in source.frames:
        alive, count = alive - 1, count + 1
        assert isinstance(frame, Frame | Dropped)
    assert count == 3000
    assert most < 40
