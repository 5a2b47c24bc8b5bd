"""Data sets as others lay them out: TUM RGB-D, 7-Scenes, ScanNet .sens, Open3D, Stray Scanner, Foxglove's MCAP."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bags import Messages, pictures, robot, write_bag
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import CompressionType, Writer
from test_ingest import write_replica
from worlds import (
    CAMERA,
    decimal_seconds,
    encode_color,
    intrinsic_matrix,
    render,
    tiny_frames,
    write_png16,
    write_scannet,
)

from openvox.apps.ingest import IngestResult, ingest
from openvox.cli import main
from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics, Pose
from openvox.formats.recording import RecordingWriter, read_frames
from openvox.formats.schemas import descriptor_bytes
from openvox.sources import FORMATS

FRAMES = tiny_frames(4, truth=False)


def ingested(source: Path, **options: Any) -> tuple[IngestResult, list[Frame]]:
    out = source.parent / "out.mcap"
    result = ingest(source, out, **options)
    return result, list(read_frames(out))


def refusal(source: Path, **options: Any) -> str:
    out = source.parent / "refused.mcap"
    with pytest.raises(InputError) as refused:
        ingest(source, out, **options)
    assert not list(source.parent.glob("refused*"))
    assert "\n" not in str(refused.value)
    return str(refused.value)


def check(found: list[Frame], expected: list[Frame] = FRAMES, *, stamps: bool = False, atol: float = 1e-9) -> None:
    assert [frame.index for frame in found] == [frame.index for frame in expected]
    for actual, frame in zip(found, expected, strict=True):
        np.testing.assert_array_equal(actual.depth, frame.depth)
        np.testing.assert_allclose(actual.world_from_depth.matrix(), frame.world_from_depth.matrix(), atol=atol)
        assert not stamps or actual.stamp_ns == frame.stamp_ns


# TUM RGB-D


def tum_line(stamp_ns: int, pose: Pose) -> str:
    return " ".join([decimal_seconds(stamp_ns), *(repr(v) for v in (*pose.translation, *pose.quaternion))])


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    """Depth every 100 ms, colour 7 ms later, poses at twice the rate, all as the data set writes them."""
    folder = tmp_path / "rgbd_dataset_tiny"
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    rgb, depth, truth = ["# color images"], ["# depth maps", "# file: 'tiny.bag'"], ["# timestamp tx ty tz qx qy qz qw"]
    for frame in FRAMES:
        stamp, later = decimal_seconds(frame.stamp_ns), decimal_seconds(frame.stamp_ns + 7_000_000)
        assert cv2.imwrite(str(folder / "rgb" / f"{later}.png"), cv2.imdecode(np.frombuffer(frame.color, np.uint8), 1))
        write_png16(folder / "depth" / f"{stamp}.png", frame.depth * 5)
        rgb.append(f"{later} rgb/{later}.png")
        depth.append(f"{stamp} depth/{stamp}.png")
        truth.append(tum_line(frame.stamp_ns, frame.world_from_depth))
    for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", truth)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    (tmp_path / "camera.txt").write_text("26 26 15.5 11.5")
    return folder


def test_tum_pictures_are_paired_by_stamp_and_depth_is_in_5000ths(tum: Path) -> None:
    result, found = ingested(tum, camera=str(tum.parent / "camera.txt"))
    check(found, stamps=True)
    assert (result.source, found[0].rig.depth, found[0].color_format) == ("tum", CAMERA, "png")
    assert "intrinsics are those of camera.txt" in result.notes


def test_tum_frames_without_colour_or_pose_are_counted(tum: Path) -> None:
    lines = (tum / "rgb.txt").read_text().splitlines()
    (tum / "rgb.txt").write_text("\n".join([*lines[:2], *lines[3:]]))
    poses = (tum / "groundtruth.txt").read_text().splitlines()
    (tum / "groundtruth.txt").write_text("\n".join(poses[:-1]))
    result, found = ingested(tum, camera=str(tum.parent / "camera.txt"))
    assert [frame.index for frame in found] == [0, 2]
    assert result.dropped == {"no colour within 20 ms": 1, "the trajectory ends before": 1}


def test_tum_names_what_is_not_in_the_folder(tum: Path) -> None:
    assert "give --camera FILE with fx fy cx cy" in refusal(tum)
    (tum.parent / "camera.txt").write_text("26 26 15.5")
    assert "camera.txt" in refusal(tum, camera=str(tum.parent / "camera.txt"))


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("soon rgb/a.png", "rgb.txt, line 1: 'soon rgb/a.png'"),
        ("1.0", "rgb.txt, line 1: '1.0'"),
        ("1.0 ../../etc/passwd", "lies outside of the folder"),
        ("1.0 /etc/passwd", "lies outside of the folder"),
        ("# nothing", "names no file"),
    ],
)
def test_tum_lists_are_checked(tum: Path, line: str, expected: str) -> None:
    (tum / "rgb.txt").write_text(line + "\n")
    assert expected in refusal(tum, camera=str(tum.parent / "camera.txt"))


# 7-Scenes


@pytest.fixture
def seven(tmp_path: Path) -> Path:
    camera = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
    folder = tmp_path / "seq-01"
    folder.mkdir()
    for frame in tiny_frames(2, truth=False):
        depth, _, _, color = render(frame.world_from_depth, camera)
        stem = f"frame-{frame.index:06d}"
        write_png16(folder / f"{stem}.depth.png", np.where(depth == 0, 65535, depth).astype(np.uint16))
        (folder / f"{stem}.color.png").write_bytes(encode_color(color, "png"))
        np.savetxt(folder / f"{stem}.pose.txt", frame.world_from_depth.matrix())
    return folder


def test_7_scenes_has_two_cameras_and_65535_is_no_depth(seven: Path) -> None:
    result, found = ingested(seven, fps=30.0)
    expected, _, _, _ = render(FRAMES[1].world_from_depth, Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0))
    np.testing.assert_array_equal(found[1].depth, expected)
    np.testing.assert_allclose(found[1].world_from_depth.matrix(), FRAMES[1].world_from_depth.matrix(), atol=1e-9)
    assert (found[0].rig.depth.fx, found[0].rig.color.fx) == (585.0, 525.0)
    assert any("585, 320, 240" in note for note in result.notes)
    (seven.parent / "camera.txt").write_text("529 529 313 238")
    assert ingested(seven, camera=str(seven.parent / "camera.txt"))[1][0].rig.color.fx == 529.0


def test_7_scenes_without_a_pose_names_the_frame(seven: Path) -> None:
    (seven / "frame-000001.pose.txt").unlink()
    assert "frame 1: expected a color.png, a depth.png and a pose.txt" in refusal(seven)


def test_7_scenes_whose_files_have_no_numbers_have_no_frames(tmp_path: Path) -> None:
    (tmp_path / "seq").mkdir()
    for name in ("frame-a.color.png", "frame-a.depth.png", "frame-a.pose.txt"):
        (tmp_path / "seq" / name).write_bytes(b"")
    assert "has no frame with a number" in refusal(tmp_path / "seq")


# ScanNet .sens


def sens_bytes(frames: list[Frame], *, stamps: bool = True, shift: float = 1000.0, codec: int = 1) -> bytes:
    """As ScanNet's own writer lays it out."""
    k = intrinsic_matrix(CAMERA).astype("<f4").tobytes()
    eye = np.eye(4, dtype="<f4").tobytes()
    out = struct.pack("<IQ", 4, 9) + b"StructureX"[:9] + k + eye + k + eye
    out += struct.pack("<iiIIIIfQ", 2, codec, 32, 24, 32, 24, shift, len(frames))
    for frame in frames:
        pose = frame.world_from_depth.matrix().astype("<f4").tobytes()
        depth = frame.depth.astype("<u2").tobytes()
        packed = zlib.compress(depth) if codec == 1 else depth
        stamp = frame.stamp_ns // 1000 if stamps else 0
        out += pose + struct.pack("<QQQQ", stamp, stamp, len(frame.color), len(packed)) + frame.color + packed
    return out + struct.pack("<Q", 0)


@pytest.mark.parametrize("codec", [0, 1])
def test_a_sens_file_gives_its_frames(tmp_path: Path, codec: int) -> None:
    path = tmp_path / "scene0000_00.sens"
    path.write_bytes(sens_bytes(FRAMES, codec=codec))
    result, found = ingested(path)
    check(found, stamps=True, atol=1e-6)
    assert [frame.color for frame in found] == [frame.color for frame in FRAMES]
    assert (result.source, result.notes) == ("sens", ())
    assert [frame.index for frame in ingested(path, start=1, stride=2)[1]] == [1, 3]


def test_a_sens_file_without_stamps_or_with_a_lost_pose_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.sens"
    data = bytearray(sens_bytes(FRAMES, stamps=False))
    first = data.index(FRAMES[0].color) - 96
    data[first : first + 64] = np.full(16, -np.inf, "<f4").tobytes()
    path.write_bytes(data)
    result, found = ingested(path, fps=10.0)
    assert [frame.stamp_ns for frame in found] == [100_000_000, 200_000_000, 300_000_000]
    assert result.dropped == {"pose is not finite": 1}
    assert "stamps were invented at 10 frames a second" in result.notes[0]


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda data: data[:200], "is cut off or damaged"),
        (lambda data: data[:-300], "is cut off or damaged"),
        (lambda data: b"\5" + data[1:], "has version 5 of .sens; expected 4"),
        (lambda data: data[:4] + struct.pack("<Q", 1 << 60) + data[12:], "is cut off or damaged"),
        (lambda data: data.replace(struct.pack("<ii", 2, 1), struct.pack("<ii", 2, 2)), "depth by 2"),
        (
            lambda data: data.replace(struct.pack("<fQ", 1000.0, 4), struct.pack("<fQ", 1000.0, 1 << 60)),
            f"it states {1 << 60} frames",
        ),
        (lambda data: data.replace(struct.pack("<f", 1000.0), struct.pack("<f", np.nan)), "in units of 1/nan m"),
        (lambda data: data.replace(b"\xff\xd8\xff", b"GIF"), "frame 0, colour: the picture begins with"),
        (lambda data: data.replace(b"\x78\x9c", b"\x00\x00"), "frame 0, depth:"),
    ],
)
def test_a_broken_sens_file_is_one_sentence(tmp_path: Path, damage: Callable[[bytes], bytes], expected: str) -> None:
    path = tmp_path / "a.sens"
    path.write_bytes(damage(sens_bytes(FRAMES)))
    assert expected in refusal(path)


def test_packed_depth_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    whole = zlib.compress(FRAMES[0].depth.astype("<u2").tobytes())
    bomb = zlib.compress(bytes(1 << 24))
    data = sens_bytes(FRAMES[:1]).replace(whole, bomb)
    data = data.replace(
        struct.pack("<QQ", len(FRAMES[0].color), len(whole)), struct.pack("<QQ", len(FRAMES[0].color), len(bomb))
    )
    (tmp_path / "a.sens").write_bytes(data)
    assert "depth has 1537 bytes; expected 1536" in refusal(tmp_path / "a.sens")


# Open3D


@pytest.fixture
def open3d(tmp_path: Path) -> Path:
    folder = tmp_path / "redwood"
    (folder / "color").mkdir(parents=True)
    (folder / "depth").mkdir()
    log = []
    for n, frame in enumerate(FRAMES):
        (folder / "color" / f"{n + 1:06d}.jpg").write_bytes(frame.color)
        write_png16(folder / "depth" / f"{n + 1:06d}.png", frame.depth)
        rows = "\n".join(" ".join(repr(float(v)) for v in row) for row in frame.world_from_depth.matrix())
        log.append(f"{n} {n} {n + 1}\n{rows}\n")
    (folder / "trajectory.log").write_text("".join(log))
    by_column = intrinsic_matrix(CAMERA)[:3, :3].T.ravel().tolist()
    content = {"width": 32, "height": 24, "intrinsic_matrix": by_column}
    (folder / "camera_intrinsic.json").write_text(json.dumps(content))
    return folder


def test_open3d_counts_files_and_has_its_matrix_by_column(open3d: Path) -> None:
    result, found = ingested(open3d)
    check(found)
    assert (result.source, found[0].rig.depth, found[0].rig.registered) == ("open3d", CAMERA, True)


def test_open3d_without_a_frames_pose_drops_it(open3d: Path) -> None:
    lines = (open3d / "trajectory.log").read_text().splitlines()
    (open3d / "trajectory.log").write_text("\n".join(lines[:5] + lines[10:]))
    assert ingested(open3d)[0].dropped == {"the trajectory lacks the frame": 1}


def test_open3d_says_what_is_wrong(open3d: Path) -> None:
    (open3d / "trajectory.log").write_text("0 0 1\n1 0 0 0\n")
    assert "trajectory.log, frame 0" in refusal(open3d)
    (open3d / "trajectory.log").write_text("9" * 5000 + " 0 1\n")
    assert "expected a line of three whole numbers" in refusal(open3d)
    (open3d / "trajectory.log").write_text("zero\n")
    assert "expected a line of three whole numbers" in refusal(open3d)
    (open3d / "camera_intrinsic.json").write_text('{"width": 32}')
    assert "camera_intrinsic.json" in refusal(open3d)
    (open3d / "depth" / "000001.png").unlink()
    assert "has 4 pictures of colour and 3 of depth" in refusal(open3d)


# Poses of another program


def test_a_kitti_trajectory_is_by_line(open3d: Path) -> None:
    (open3d / "trajectory.log").unlink()
    lines = [" ".join(repr(float(v)) for v in f.world_from_depth.matrix()[:3].ravel()) for f in FRAMES[:3]]
    (open3d.parent / "poses.txt").write_text("\n".join(lines))
    result, found = ingested(open3d, poses=open3d.parent / "poses.txt")
    check(found, FRAMES[:3])
    assert result.dropped == {"the trajectory ends before": 1}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 2 3", "has lines of 3 numbers; expected 8 (TUM"),
        ("", "has 0 bytes"),
        ("# nothing\n", "has lines of unequally many numbers"),
        ("1 0 0 0 0 0 0 2", "line 1: pose quaternion has length 2"),
        ("x 0 0 0 0 0 0 1", "line 1: 'x 0 0 0 0 0 0 1' holds something that is no number"),
        ("-1 0 0 0 0 0 0 1", "line 1: stamp '-1'"),
        ("1 0 0 0 0 1 0 0 0 0 2 0", "line 1: pose matrix is not a rotation"),
    ],
)
def test_a_bad_trajectory_is_named_by_line(open3d: Path, text: str, expected: str) -> None:
    (open3d.parent / "poses.txt").write_text(text)
    assert expected in refusal(open3d, poses=open3d.parent / "poses.txt")


def test_files_that_are_read_are_not_written_over(open3d: Path) -> None:
    poses = open3d.parent / "poses.txt"
    poses.write_text(tum_line(0, Pose.identity()))
    with pytest.raises(InputError, match="is read itself"):
        ingest(open3d, poses, poses=poses)


# Stray Scanner


@pytest.fixture
def stray(tmp_path: Path) -> Path:
    """A scan whose film has twice the size of its depth."""
    folder = tmp_path / "scan"
    (folder / "depth").mkdir(parents=True)
    film = cv2.VideoWriter(str(folder / "rgb.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, (64, 48))
    rows = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    for n, frame in enumerate(FRAMES):
        film.write(np.full((48, 64, 3), 60 * n, np.uint8))
        write_png16(folder / "depth" / f"{n:06d}.png", frame.depth)
        numbers = ", ".join(repr(v) for v in (*frame.world_from_depth.translation, *frame.world_from_depth.quaternion))
        rows.append(f"{decimal_seconds(frame.stamp_ns)}, {n:06d}, {numbers}")
    film.release()
    (folder / "odometry.csv").write_text("\n".join(rows))
    (folder / "camera_matrix.csv").write_text("52.0, 0.0, 31.5\n0.0, 52.0, 23.5\n0.0, 0.0, 1.0\n")
    return folder


def test_a_phone_scan_gives_its_film_beside_its_depth(stray: Path) -> None:
    result, found = ingested(stray)
    check(found, stamps=True)
    assert result.source == "stray"
    assert found[0].rig.color == Intrinsics(64, 48, 52.0, 52.0, 31.5, 23.5)
    assert found[0].rig.depth == CAMERA
    for n, frame in enumerate(found):
        image = cv2.imdecode(np.frombuffer(frame.color, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert abs(float(image.mean()) - 60 * n) < 6
    skipped = ingested(stray, start=3)[1][0]  # the film is gone through up to the frame
    image = cv2.imdecode(np.frombuffer(skipped.color, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert abs(float(image.mean()) - 180) < 6


def test_a_phone_scan_that_is_broken_is_one_sentence(stray: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (stray / "odometry.csv").write_text("timestamp, frame, x\n1, 0, 2\n")
    assert "odometry.csv has columns timestamp, frame, x" in refusal(stray)
    (stray / "odometry.csv").write_text("timestamp, frame, x, y, z, qx, qy, qz, qw\n1, 0, a, 0, 0, 0, 0, 0, 1\n")
    assert "odometry.csv, line 2" in refusal(stray)
    (stray / "odometry.csv").write_text("timestamp, frame, x, y, z, qx, qy, qz, qw\n1, 0, 0, 0, 0, 0, 0, 0, 1\n")
    (stray / "rgb.mp4").write_bytes(b"no film")
    assert "cannot be decoded" in refusal(stray)


def test_record3d_says_how_to_convert(tmp_path: Path) -> None:
    (tmp_path / "a.r3d").write_bytes(b"PK")
    assert "unpack it" in refusal(tmp_path / "a.r3d")


# Foxglove's schemas


def foxglove(path: Path, frames: list[Frame], compression: CompressionType = CompressionType.LZ4) -> Path:
    """A robot's file, written by the mcap library: no chunk limits of ours, another packing, poses on /tf."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start(profile="", library="a robot")
        channels: dict[str, int] = {}

        def add(topic: str, stamp: int, message: Any) -> None:
            if topic not in channels:
                kind = message.DESCRIPTOR.full_name
                schema = writer.register_schema(kind, "protobuf", descriptor_bytes(message))
                channels[topic] = writer.register_channel(topic, "protobuf", schema)
            message.timestamp.FromNanoseconds(stamp)
            writer.add_message(channels[topic], stamp + 1_000_000, message.SerializeToString(), stamp, 0)

        for frame in frames:
            stamp = frame.stamp_ns
            k = intrinsic_matrix(CAMERA)[:3, :3].ravel().tolist()
            for name in ("rgb", "depth"):
                add(f"/{name}/calibration", stamp, CameraCalibration(frame_id="cam", width=32, height=24, K=k))
            add("/rgb/image", stamp, CompressedImage(frame_id="cam", data=frame.color, format="jpeg"))
            metres = (frame.depth / 1000.0).astype("<f4").tobytes()
            depth = RawImage(frame_id="cam", width=32, height=24, encoding="32FC1", step=128, data=metres)
            add("/depth/image", stamp, depth)
            transform = FrameTransform(parent_frame_id="map", child_frame_id="cam")
            for part, names, values in (
                (transform.translation, "xyz", frame.world_from_depth.translation),
                (transform.rotation, "xyzw", frame.world_from_depth.quaternion),
            ):
                for name, value in zip(names, values, strict=True):
                    setattr(part, name, value)
            add("/tf", stamp, transform)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_a_robots_file_in_foxgloves_schemas_is_read(tmp_path: Path, compression: CompressionType) -> None:
    result, found = ingested(foxglove(tmp_path / "robot.mcap", FRAMES, compression))
    check(found, stamps=True)
    assert [frame.color for frame in found] == [frame.color for frame in FRAMES]
    assert result.source == "foxglove"
    assert result.notes[1] == "poses are those of cam in map"


def test_a_recording_of_openvox_is_read_like_a_robots_but_with_truth_it_is_none(tmp_path: Path) -> None:
    for truth in (True, False):
        with RecordingWriter(tmp_path / "a.mcap", source="test") as writer:
            for frame in tiny_frames(3, truth=truth):
                writer.add(frame)
        if truth:
            assert "seems to be a recording of openvox already" in refusal(tmp_path / "a.mcap")
        else:
            check(ingested(tmp_path / "a.mcap")[1], tiny_frames(3))


def test_a_broken_robots_file_is_one_sentence(tmp_path: Path) -> None:
    path = foxglove(tmp_path / "robot.mcap", FRAMES)
    data = path.read_bytes()
    for broken in (
        data[:-300],
        data[:500],
        data[: len(data) // 2] + bytes(64) + data[len(data) // 2 + 64 :],
        b"\x89MCAP0",
    ):
        path.write_bytes(broken)
        assert "robot.mcap" in refusal(path)


# docs/sources.md

DOCS = (Path(__file__).resolve().parents[1] / "docs" / "sources.md").read_text(encoding="utf-8")
LINES = dict(re.findall(r"^\| `(\w+)` \|.*\| `openvox (ingest [^`]+)` \|$", DOCS, re.MULTILINE))


def test_every_format_has_its_line_in_the_docs() -> None:
    assert set(LINES) == set(FORMATS) - {"record3d"}
    assert "| `record3d` |" in DOCS


def grown(folder: Path) -> None:
    """The pictures of a folder at 640x480, as the data set has them."""
    for path in folder.rglob("*.png"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        assert cv2.imwrite(str(path), cv2.resize(image, (640, 480), interpolation=cv2.INTER_NEAREST))


def test_the_lines_of_the_docs_work_when_copied(
    tmp_path: Path,
    tum: Path,
    seven: Path,
    open3d: Path,
    stray: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    grown(tum)
    make = Messages()
    places = {name: tmp_path / "docs" / shlex.split(line)[1] for name, line in LINES.items()}
    for place in places.values():
        place.parent.mkdir(parents=True, exist_ok=True)
    for name, folder in (("tum", tum), ("7scenes", seven), ("open3d", open3d), ("stray", stray)):
        shutil.move(folder, places[name])
    write_bag(places["ros"], make, [*robot(make, FRAMES), *pictures(make, FRAMES)])
    write_scannet(places["scannet"], tiny_frames(4))
    write_replica(places["replica"], [])
    places["sens"].write_bytes(sens_bytes(FRAMES))
    foxglove(places["foxglove"], FRAMES)
    monkeypatch.chdir(tmp_path / "docs")
    for name, line in LINES.items():
        with pytest.raises(SystemExit) as end:
            main([*shlex.split(line), "--json"])
        assert end.value.code == 0
        said = json.loads(capsys.readouterr().out)
        assert said["source"] == {"ros": "ros2"}.get(name, name)
        assert said["frames"] >= 2
