"""ingest: folders of exported frames become recordings; what is missing or wrong is named, what is assumed is said."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from worlds import CAMERA, CATEGORIES, encode_color, intrinsic_matrix, render, tiny_frames, write_png16, write_scannet

from openvox.apps.ingest import IngestResult, far, ingest
from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics, Pose
from openvox.formats.recording import read_frames, recording_info
from openvox.sources import open_source


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Three tiny frames as an exported ScanNet scene."""
    return write_scannet(tmp_path / "scene", tiny_frames(3))


def frames_of(folder: Path, **options: object) -> list[Frame]:
    """The folder's frames by way of a recording."""
    out = folder.parent / "frames.mcap"
    ingest(folder, out, **options)  # type: ignore[arg-type]
    return list(read_frames(out))


def refusal(folder: Path, **options: object) -> str:
    """The sentence with which a folder is refused; an older recording must survive it, and nothing else be left."""
    out = folder.parent / "refused.mcap"
    out.write_bytes(b"older")
    with pytest.raises(InputError) as refused:
        ingest(folder, out, **options)  # type: ignore[arg-type]
    assert out.read_bytes() == b"older"
    assert not out.with_name("refused.mcap.partial").exists()
    return str(refused.value)


# ScanNet


def test_a_scene_is_recorded_as_it_is(scene: Path, tmp_path: Path) -> None:
    result = ingest(scene, tmp_path / "a.mcap")
    expected, read = tiny_frames(3), list(read_frames(tmp_path / "a.mcap"))
    for actual, frame in zip(read, expected, strict=True):
        assert (actual.index, actual.stamp_ns, actual.color, actual.rig) == (
            frame.index,
            frame.stamp_ns,
            frame.color,
            frame.rig,
        )
        np.testing.assert_allclose(actual.world_from_depth.matrix(), frame.world_from_depth.matrix(), atol=1e-14)
        np.testing.assert_array_equal(actual.depth, frame.depth)
        assert actual.truth_instances is not None
        assert frame.truth_instances is not None
        np.testing.assert_array_equal(actual.truth_instances, frame.truth_instances)
    assert recording_info(tmp_path / "a.mcap").categories == CATEGORIES
    assert result == IngestResult(
        output=str(tmp_path / "a.mcap"),
        replaced=False,
        source="scannet",
        frames=3,
        first=0,
        last=2,
        dropped={},
        seconds=0.2,
        path_length_m=pytest.approx(0.16),
        depth_range_m=result.depth_range_m,
        has_truth=True,
        notes=(),
        findings=(),
        digest=recording_info(tmp_path / "a.mcap").digest,
    )
    near, far = result.depth_range_m
    assert 1.5 < near < 2.0 < far < 8.0


def test_the_same_scene_elsewhere_gives_the_same_bytes_and_an_older_file_is_replaced(
    scene: Path, tmp_path: Path
) -> None:
    shutil.copytree(scene, tmp_path / "copy")
    ingest(scene, tmp_path / "a.mcap")
    first = (tmp_path / "a.mcap").read_bytes()
    assert ingest(tmp_path / "copy", tmp_path / "a.mcap").replaced
    assert (tmp_path / "a.mcap").read_bytes() == first


def test_progress_is_told_once_a_frame(scene: Path, tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    ingest(scene, tmp_path / "a.mcap", progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 3), (2, 3), (3, 3)]


def test_lost_poses_are_dropped_counted_and_leave_gaps(scene: Path, tmp_path: Path) -> None:
    (scene / "pose" / "000001.txt").write_text("-inf " * 16)
    result = ingest(scene, tmp_path / "a.mcap")
    assert result.dropped == {"pose is not finite": 1}
    assert [frame.index for frame in read_frames(tmp_path / "a.mcap")] == [0, 2]


def test_a_scene_without_any_pose_is_refused_with_the_reason(scene: Path) -> None:
    for path in (scene / "pose").iterdir():
        path.write_text("-inf " * 16)
    assert "there is no frame to record (dropped: 3 with pose is not finite)" in refusal(scene)


def test_unpadded_names_are_sorted_by_number(tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scene", tiny_frames(12), digits=0)
    assert (folder / "color" / "9.jpg").exists()
    assert [frame.index for frame in frames_of(folder)] == list(range(12))


def test_start_end_and_stride_are_frame_numbers(tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scene", tiny_frames(6, first=2, stride=2))  # 2, 4, ... 12
    frames = frames_of(folder, start=4, end=12, stride=4)
    assert [(frame.index, frame.stamp_ns) for frame in frames] == [(4, 1_400_000_000), (8, 1_800_000_000)]
    assert "has frames 2 to 12; none of them is from 13 to before the end" in refusal(folder, start=13)
    assert "stride is 0" in refusal(folder, stride=0)


def test_decimal_stamps_become_exact_nanoseconds(scene: Path) -> None:
    (scene / "stamps.txt").write_text("0.097805\n1305031102.175304123\n1305031102.1753041235\n")
    assert [frame.stamp_ns for frame in frames_of(scene)] == [97805000, 1305031102175304123, 1305031102175304124]


def test_without_stamps_they_are_invented_and_the_recording_says_so(scene: Path, tmp_path: Path) -> None:
    (scene / "stamps.txt").unlink()
    result = ingest(scene, tmp_path / "a.mcap", fps=29.97)
    assert [frame.stamp_ns for frame in read_frames(tmp_path / "a.mcap")] == [0, 33366700, 66733400]
    assert result.notes == ("stamps were invented at 29.97 frames a second: there is no stamps.txt",)
    assert json.loads(recording_info(tmp_path / "a.mcap").metadata["notes"]) == list(result.notes)
    assert "the frame rate is 0" in refusal(scene, fps=0.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0\n1\n", "stamps.txt has 2 stamps; expected 3"),
        ("0\n2\n1\n", "stamps.txt, line 3: stamp 1 comes not after the one before"),
        ("0\nsoon\n1\n", "stamps.txt, line 2: stamp 'soon'"),
        ("0\nnan\n1\n", "stamps.txt, line 2: stamp 'nan'"),
        ("0\n1e999999999\n1\n", "stamps.txt, line 2: stamp '1e999999999'"),
        ("-1\n0\n1\n", "stamps.txt, line 1: stamp '-1'"),
    ],
)
def test_bad_stamps_are_named_by_line(scene: Path, text: str, expected: str) -> None:
    (scene / "stamps.txt").write_text(text)
    assert expected in refusal(scene)


def test_a_camera_beyond_the_reach_of_voxels_is_told_with_the_origin_that_cures_it() -> None:
    pose = np.broadcast_to(np.eye(4), (2, 4, 4)).copy()
    pose[:, 1, 3] = 41_900.0, 41_950.0
    (note,) = far(pose)  # voxels of 4 cm reach 2^20 x 0.04 = 41,943.04 m
    assert note.endswith("replay would stop; ingest again with --origin 0,41900,0")
    assert far(pose[:1]) == far(pose[:0]) == []


def test_the_origin_is_subtracted_and_recorded(scene: Path, tmp_path: Path) -> None:
    matrix = tiny_frames(1)[0].world_from_depth.matrix()
    matrix[:3, 3] = (455200.25, 5411900.5, 101.0)
    np.savetxt(scene / "pose" / "000000.txt", matrix, fmt="%.17g")
    ingest(scene, tmp_path / "a.mcap", origin=(455200, 5411900, -1), end=1)
    assert next(read_frames(tmp_path / "a.mcap")).world_from_depth.translation == (0.25, 0.5, 102.0)
    assert recording_info(tmp_path / "a.mcap").origin_m == (455200, 5411900, -1)


@pytest.mark.parametrize("beside", [True, False])
def test_scannets_own_table_names_the_categories(scene: Path, tmp_path: Path, beside: bool) -> None:
    (scene / "objects.json").unlink()
    table = "id\traw_category\tcategory\n7\tcoffee table\ttable\n29\tcarton\t\n"
    (scene if beside else tmp_path).joinpath("scannetv2-labels.combined.tsv").write_text(table)
    ingest(scene, tmp_path / "a.mcap")
    assert recording_info(tmp_path / "a.mcap").categories == {7: "table", 29: "carton"}
    (scene / "scannetv2-labels.combined.tsv").write_text("a\tb\n1\t2\n")
    assert "scannetv2-labels.combined.tsv cannot be read" in refusal(scene)


# Two cameras


def with_large_colour(scene: Path, factor: int = 2) -> Intrinsics:
    """Colour and truth rendered again at twice the size; returns their camera."""
    camera = Intrinsics(32 * factor, 24 * factor, 26.0 * factor, 26.0 * factor, 16 * factor - 0.5, 12 * factor - 0.5)
    for frame in tiny_frames(3):
        _, instances, categories, color = render(frame.world_from_depth, camera)
        (scene / "color" / f"{frame.index:06d}.jpg").write_bytes(encode_color(color, "jpeg"))
        write_png16(scene / "instance-filt" / f"{frame.index:06d}.png", instances)
        write_png16(scene / "label-filt" / f"{frame.index:06d}.png", categories)
    np.savetxt(scene / "intrinsic" / "intrinsic_color.txt", intrinsic_matrix(camera))
    return camera


def test_colour_and_depth_keep_their_own_cameras(scene: Path, tmp_path: Path) -> None:
    camera = with_large_colour(scene)
    result = ingest(scene, tmp_path / "a.mcap")
    frame = next(read_frames(tmp_path / "a.mcap"))
    assert (frame.rig.color, frame.rig.depth) == (camera, CAMERA)
    assert frame.depth.shape == (24, 32)
    assert frame.truth_instances is not None
    assert frame.truth_instances.shape == (48, 64)
    assert not frame.rig.registered
    assert "nothing was resampled" in result.notes[0]


@pytest.mark.parametrize("removed", ["intrinsic_color.txt", "intrinsic_depth.txt"])
def test_one_camera_is_scaled_to_the_other_picture_and_that_is_said(scene: Path, tmp_path: Path, removed: str) -> None:
    camera = with_large_colour(scene)
    (scene / "intrinsic" / removed).unlink()
    result = ingest(scene, tmp_path / "a.mcap")
    rig = recording_info(tmp_path / "a.mcap").rig
    assert (rig.color, rig.depth) == (camera, CAMERA)  # (15.5 + 0.5) * 2 - 0.5 = 31.5, and back
    assert "one camera's intrinsics are given" in result.notes[0]
    assert "scaled to 64x48 for colour and 32x24 for depth" in result.notes[0]


def test_an_extrinsic_of_the_colour_camera_is_kept(scene: Path) -> None:
    np.savetxt(scene / "intrinsic" / "extrinsic_depth.txt", np.eye(4))
    beside = np.eye(4)
    beside[0, 3] = 0.025
    np.savetxt(scene / "intrinsic" / "extrinsic_color.txt", beside)
    assert frames_of(scene)[0].rig.depth_from_color == Pose((0.0, 0.0, 0.0, 1.0), (0.025, 0.0, 0.0))
    np.savetxt(scene / "intrinsic" / "extrinsic_depth.txt", beside)
    assert "extrinsic_depth.txt is no identity" in refusal(scene)


# What is wrong in a folder


def test_a_folder_of_nothing_says_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    text = refusal(tmp_path / "empty")
    assert "scannet wants color/ depth/ pose/ intrinsic/; replica" in text
    assert "replica wants results/ traj.txt cam_params.json" in text
    assert "is not there" in refusal(tmp_path / "nowhere")
    (tmp_path / "file").touch()
    assert "is a file" in refusal(tmp_path / "file")
    assert "there is no format 'kitti'; known: auto, ros, scannet, replica, sens" in refusal(
        tmp_path / "empty", format="kitti"
    )


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-30])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def write_8_bit(path: Path) -> None:
    assert cv2.imwrite(str(path), np.zeros((24, 32), np.uint8))


def write_colours(path: Path) -> None:
    assert cv2.imwrite(str(path), np.zeros((24, 32, 3), np.uint16))


def write_smaller(path: Path) -> None:
    assert cv2.imwrite(str(path), np.zeros((12, 32), np.uint16))


def write_smaller_jpeg(path: Path) -> None:
    path.write_bytes(encode_color(np.zeros((8, 8, 3), np.uint8), "jpeg"))


def empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize(
    ("file", "damage", "expected"),
    [
        ("depth/000001.png", Path.unlink, "has no file of frame 1 in depth/"),
        ("color/000001.jpg", Path.unlink, "has no file of frame 1 in color/"),
        ("pose/000001.txt", Path.unlink, "has no file of frame 1 in pose/"),
        ("label-filt/000001.png", Path.unlink, "has no file of frame 1 in label-filt/"),
        ("color/000001.jpg", empty, "color/000001.jpg has 0 bytes"),
        ("color/000001.jpg", truncate, "color/000001.jpg: the JPEG file is cut off"),
        (
            "color/000001.jpg",
            write_smaller_jpeg,
            "color/000001.jpg is 8x8 pixels; expected 32x24 as in the first frame",
        ),
        ("color/000001.jpg", lambda p: p.write_text("GIF89a"), "color/000001.jpg: the picture begins with 47494638"),
        ("depth/000001.png", empty, "depth/000001.png has 0 bytes"),
        ("depth/000001.png", truncate, "depth/000001.png: the PNG file is cut off"),
        ("depth/000001.png", flip, "depth/000001.png: the PNG file is damaged"),
        (
            "depth/000001.png",
            write_8_bit,
            "depth/000001.png: the PNG has 8 bits and colour type 0; expected 16 bits of grey",
        ),
        ("depth/000001.png", write_colours, "depth/000001.png: the PNG has 16 bits and colour type 2"),
        ("depth/000001.png", write_smaller, "depth/000001.png is 32x12 pixels; expected 32x24"),
        (
            "depth/000000.png",
            lambda p: p.write_text("no picture"),
            "depth/000000.png: the picture begins with 6e6f2070",
        ),
        ("instance-filt/000002.png", write_smaller, "instance-filt/000002.png is 32x12 pixels"),
        ("pose/000001.txt", empty, "pose/000001.txt has 0 bytes"),
        ("pose/000001.txt", lambda p: p.write_text("1 2 3"), "pose/000001.txt holds 3 numbers"),
        ("pose/000001.txt", lambda p: p.write_text("one " * 16), "could not convert string to float: 'one'"),
        (
            "pose/000001.txt",
            lambda p: np.savetxt(p, np.diag([1.0, 2, 1, 1])),
            "pose/000001.txt: pose matrix is not a rotation",
        ),
        (
            "pose/000001.txt",
            lambda p: np.savetxt(p, np.diag([1.0, 1, -1, 1])),
            "pose/000001.txt: pose matrix mirrors space",
        ),
        (
            "pose/000001.txt",
            lambda p: np.savetxt(p, np.eye(4) + np.eye(4)[3:].T @ [[1, 2, 3, 0]]),
            "is the matrix transposed?",
        ),
        (
            "intrinsic/intrinsic_depth.txt",
            lambda p: np.savetxt(p, np.zeros((4, 4))),
            "intrinsic_depth.txt: intrinsics fx, fy, cx, cy are",
        ),
        ("intrinsic/intrinsic_depth.txt", lambda p: p.write_bytes(b"\xff\xfe"), "intrinsic_depth.txt is no text file"),
        ("objects.json", lambda p: p.write_text("{"), "objects.json: its categories cannot be read"),
        (
            "objects.json",
            lambda p: p.write_text('{"categories": {"chair": "x"}}'),
            "objects.json: its categories cannot be read",
        ),
    ],
)
def test_a_bad_file_is_named_and_nothing_is_written(
    scene: Path, file: str, damage: Callable[[Path], object], expected: str
) -> None:
    damage(scene / file)
    assert expected in refusal(scene)


def test_two_files_of_one_number_are_refused(scene: Path) -> None:
    shutil.copy(scene / "color" / "000001.jpg", scene / "color" / "1.jpg")
    assert "are both frame 1; keep one of them" in refusal(scene)


def test_instance_pictures_of_8_bits_are_taken_as_ids(scene: Path) -> None:
    ids = np.full((24, 32), 7, np.uint8)
    assert cv2.imwrite(str(scene / "instance-filt" / "000000.png"), ids)
    truth = frames_of(scene)[0].truth_instances
    assert truth is not None
    np.testing.assert_array_equal(truth, ids.astype(np.uint16), strict=True)


def test_a_file_of_the_source_is_never_written_over(scene: Path) -> None:
    target = scene / "depth" / "000001.png"
    before = target.read_bytes()
    with pytest.raises(InputError, match="is a file of the source"):
        ingest(scene, target)
    assert target.read_bytes() == before
    assert not ingest(scene, scene / "scene.mcap").replaced
    assert ingest(scene, scene / "scene.mcap").replaced


# Replica


def write_replica(folder: Path, raw_depth: list[int]) -> Path:
    """Two tiny frames as NICE-SLAM renders Replica; the second's first depth pixels are those given."""
    (folder / "results").mkdir(parents=True)
    lines = []
    for frame in tiny_frames(2):
        raw = np.zeros((24, 32), np.uint16)
        raw[0, : len(raw_depth)] = raw_depth
        (folder / "results" / f"frame{frame.index:06d}.jpg").write_bytes(frame.color)
        write_png16(folder / "results" / f"depth{frame.index:06d}.png", raw)
        lines.append(" ".join(f"{value:.17g}" for value in frame.world_from_depth.matrix().ravel()))
    (folder / "traj.txt").write_text("\n".join(lines) + "\n")
    camera = {"w": 32, "h": 24, "fx": 26.0, "fy": 26.0, "cx": 15.5, "cy": 11.5, "scale": 6553.5}
    (folder.parent / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return folder


def test_replica_depth_is_rounded_to_millimetres_once(tmp_path: Path) -> None:
    # raw / 6553.5 m: 0.458, 0.610, 499.962, 500.114, 999.924, 1000.076 and 10000 mm
    folder = write_replica(tmp_path / "room0", [3, 4, 3276, 3277, 6553, 6554, 65535])
    result = ingest(folder, tmp_path / "a.mcap")
    frames = list(read_frames(tmp_path / "a.mcap"))
    assert frames[1].depth[0, :8].tolist() == [0, 1, 500, 500, 1000, 1000, 10000, 0]
    assert [frame.stamp_ns for frame in frames] == [0, 33333333]
    assert frames[1].color == tiny_frames(2)[1].color
    np.testing.assert_allclose(
        frames[1].world_from_depth.matrix(), tiny_frames(2)[1].world_from_depth.matrix(), atol=1e-14
    )
    info = recording_info(tmp_path / "a.mcap")
    assert (info.source, info.depth_unit, info.rig.registered) == ("replica", "1/6553.5 m", True)
    assert [note.split(" ")[0] for note in result.notes] == ["stamps", "depth"]


def test_halves_of_a_millimetre_go_to_the_even_one(tmp_path: Path) -> None:
    folder = write_replica(tmp_path / "room0", [1, 3, 5, 7])
    parameters = tmp_path / "cam_params.json"
    parameters.write_text(parameters.read_text().replace("6553.5", "2000"))
    assert frames_of(folder)[0].depth[0, :4].tolist() == [0, 2, 2, 4]  # 0.5, 1.5, 2.5, 3.5 mm


def test_replica_poses_that_are_missing_or_lost(tmp_path: Path) -> None:
    folder = write_replica(tmp_path / "room0", [])
    lines = (folder / "traj.txt").read_text().splitlines()
    (folder / "traj.txt").write_text(lines[0] + "\n" + "nan " * 16)
    assert ingest(folder, tmp_path / "a.mcap").dropped == {"pose is not finite": 1}
    (folder / "traj.txt").write_text(lines[0])
    assert "frame 1: expected frame000001.jpg and depth000001.png in results/ and line 2 of traj.txt" in refusal(folder)


def test_replica_cameras_that_are_no_cameras_are_named(tmp_path: Path) -> None:
    folder = write_replica(tmp_path / "room0", [])
    (tmp_path / "cam_params.json").write_text('{"camera": {"w": 32}}')
    assert "cam_params.json: expected camera" in refusal(folder)
    (tmp_path / "cam_params.json").unlink()
    assert "and lacks cam_params.json" in refusal(folder, format="replica")


def test_the_depth_unit_must_be_plausible(tmp_path: Path) -> None:
    folder = write_replica(tmp_path / "room0", [])
    parameters = tmp_path / "cam_params.json"
    parameters.write_text(parameters.read_text().replace("6553.5", "1"))
    assert "depth scale is 1; expected 1000 to 1000000" in refusal(folder)


# The data beside the project


def test_two_real_cameras_are_recorded_as_two(shared_data: Path, tmp_path: Path) -> None:
    ingest(shared_data / "real_kitchen", tmp_path / "a.mcap", end=2)
    rig = recording_info(tmp_path / "a.mcap").rig
    assert rig.color == Intrinsics(640, 480, 529.0, 529.0, 313.0, 238.0)
    assert rig.depth == Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
    assert rig.depth_from_color == Pose.identity()


def test_a_rendered_room_is_recorded_exactly(shared_data: Path, tmp_path: Path) -> None:
    scene = shared_data / "dev_living"
    result = ingest(scene, tmp_path / "a.mcap", start=5, stride=60)
    assert (result.frames, result.first, result.last, result.notes) == (3, 5, 125, ())
    for frame in read_frames(tmp_path / "a.mcap"):
        stem = f"{frame.index:06d}"
        assert frame.color == (scene / "color" / f"{stem}.jpg").read_bytes()
        for folder, image in (("depth", frame.depth), ("instance-filt", frame.truth_instances)):
            expected = cv2.imread(str(scene / folder / f"{stem}.png"), cv2.IMREAD_UNCHANGED)
            assert image is not None
            np.testing.assert_array_equal(image, expected)
        pose = np.loadtxt(scene / "pose" / f"{stem}.txt")
        np.testing.assert_allclose(frame.world_from_depth.matrix(), pose, atol=2e-8)
        assert frame.rig.registered
    stamps = (scene / "stamps.txt").read_text().split()
    assert next(read_frames(tmp_path / "a.mcap")).stamp_ns == int(stamps[5].replace(".", "")) * 1000


def test_a_source_can_be_read_without_recording_it(scene: Path) -> None:
    source = open_source(scene, stride=2)
    frames = list(source.frames)
    assert (source.kind, source.total, source.categories) == ("scannet", 2, CATEGORIES)
    assert [frame.index for frame in frames] == [0, 2]
