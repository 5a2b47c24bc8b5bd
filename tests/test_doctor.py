"""doctor: a good recording broken in every way is found out, a good one left alone, and nothing is guessed."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from broken import BREAKS, black, broken, clock, gap, holes, late, turned
from worlds import CAMERA, encode_color, look_at, tiny_frames, write_scannet

from openvox.apps.doctor import doctor, examined
from openvox.apps.examining.finding import Code, Finding
from openvox.apps.examining.frames import examine_frames, full, intrinsics
from openvox.apps.examining.motion import examine_motion
from openvox.apps.examining.registration import examine_registration
from openvox.apps.examining.sample import Sample, take_sample
from openvox.apps.ingest import ingest
from openvox.cli import main
from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics, Pose, Rig
from openvox.formats.images import decode_color
from openvox.formats.recording import RecordingWriter, read_frames
from openvox.sources import Options, open_source

DEMO = Path(__file__).resolve().parents[1] / "recordings" / "living_demo.mcap"
CURES = {
    "depth x 5": "--depth-scale 0.2",
    "depth / 5": "--depth-scale 5",
    "depth / 1000": "--depth-scale 1000",
    "axes of OpenGL": "--pose-axes RUB",
    "axes of a body (FLU)": "--pose-axes FLU",
    "axes of Unity, left-handed": "--pose-axes RUF",
    "poses inverted": "--poses-inverted",
    "poses turned 10 deg, x": "--extrinsic FILE with the lines 1.0000 ",
    "quaternion w first": "--poses FILE",
    "focal x 1.2": "--camera FILE",
}
SHIFTS = {"poses 50 ms late": 0.05, "poses 50 ms early": -0.05, "poses 200 ms late": 0.2}
OF_FRAMES = {"stamps", "clock", "black", "depth_missing"}


@pytest.fixture(scope="module")
def good() -> list[Frame]:
    """Forty frames of the bundled recording: four seconds."""
    return whole()[:40]


@cache
def whole() -> list[Frame]:
    """All eighty frames of the bundled recording, made small: 160x120 pixels."""
    return [small(frame) for frame in read_frames(DEMO, truth=False)]


def small(frame: Frame) -> Frame:
    """Every fourth pixel, of both cameras alike."""
    c = frame.rig.depth
    camera = Intrinsics(c.width // 4, c.height // 4, c.fx / 4, c.fy / 4, (c.cx - 1.5) / 4, (c.cy - 1.5) / 4)
    color = decode_color(frame).reshape(camera.height, 4, camera.width, 4, 3).mean((1, 3)).astype(np.uint8)
    depth = frame.depth[1::4, 1::4]
    return replace(frame, rig=Rig(camera, camera), depth=depth, color=encode_color(color, "png"), color_format="png")


def sampled(frames: list[Frame]) -> Sample:
    sample = take_sample([frames], len(frames))
    assert sample is not None
    return sample


def found(frames: list[Frame]) -> tuple[Finding, ...]:
    return examined(Path("frames"), "recording", [frames], len(frames), None).findings


def written(path: Path, frames: list[Frame]) -> Path:
    with RecordingWriter(path, source="test") as writer:
        for frame in frames:
            writer.add(frame)
    return path


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return int(end.value.code or 0)


@pytest.mark.parametrize("name", [name for name, (code, _) in BREAKS.items() if code[:4] in ("pose", "dept", "intr")])
def test_what_is_wrong_with_poses_depth_and_intrinsics_is_found(good: list[Frame], name: str) -> None:
    sample = sampled(broken(good, name))
    findings = examine_frames(sample) or examine_motion(sample)[0]
    assert [one.code for one in findings] == [BREAKS[name][0]], findings
    assert CURES.get(name, "openvox ingest") in findings[0].cure
    if name in SHIFTS:
        assert float(findings[0].cure.rpartition(" ")[2]) == pytest.approx(SHIFTS[name], abs=0.03)


@pytest.mark.parametrize("name", [name for name, (code, _) in BREAKS.items() if code in OF_FRAMES])
def test_what_is_wrong_with_single_frames_is_found(name: str) -> None:
    findings = examine_frames(sampled(broken(whole(), name)))
    assert [one.code for one in findings] == [BREAKS[name][0]], findings


@pytest.mark.parametrize("name", ["colour turned 10 deg, y", "colour turned 10 deg, z", "colour shifted by 3 %"])
def test_colour_that_does_not_lie_on_depth_is_found(good: list[Frame], name: str) -> None:
    findings, _ = examine_registration(sampled(broken(good[::4], name)))
    assert [one.code for one in findings] == ["registration"]


def test_nothing_is_said_of_a_good_recording_or_pieces_of_it(good: list[Frame]) -> None:
    for frames in (good, good[13:33]):
        assert found(frames) == ()


def test_every_break_has_a_code_of_the_contract() -> None:
    assert {code for code, _ in BREAKS.values()} == set(get_args(Code)) - {"masks"}


def test_the_cure_cures(good: list[Frame], tmp_path: Path) -> None:
    """A folder with OpenGL's poses, and one with depth in fifths of millimetres, read again with what was said."""
    frames = broken(good, "axes of OpenGL")
    folder = write_scannet(tmp_path / "gl", frames)
    assert [one.code for one in doctor(folder).findings] == ["pose_axes"]
    assert doctor(folder, pose_axes="RUB").findings == ()
    ingest(folder, tmp_path / "gl.mcap", pose_axes="RUB")
    for frame, right in zip(read_frames(tmp_path / "gl.mcap"), good, strict=True):
        assert np.allclose(frame.world_from_depth.matrix(), right.world_from_depth.matrix(), atol=1e-9)
    fifths = write_scannet(tmp_path / "fifths", broken(good, "depth x 5"))
    assert doctor(fifths, depth_scale=0.2).findings == ()


def test_a_turned_world_or_another_origin_is_no_fault(good: list[Frame]) -> None:
    world = np.eye(4)
    world[:3, :3] = look_at((0.0, 0.0, 0.0), (0.3, 0.9, 0.2)).matrix()[:3, :3]
    world[:3, 3] = (1000.0, -200.0, 3.0)
    moved = [replace(f, world_from_depth=Pose.from_matrix(world @ f.world_from_depth.matrix())) for f in good]
    assert examine_motion(sampled(moved))[0] == []


def test_a_camera_that_stands_still_gives_no_reason_to_guess(good: list[Frame]) -> None:
    still = [replace(good[0], index=i, stamp_ns=f.stamp_ns) for i, f in enumerate(good)]
    for name in ("axes of OpenGL", "depth x 5", "focal x 1.2"):
        findings, notes = examine_motion(sampled(broken(still, name)))
        assert findings == []
        assert "hardly moves" in notes[0]
    findings, notes = examine_motion(sampled(good[:2]))
    assert findings == []
    assert "too few frames" in notes[0]


def test_a_little_is_no_fault(good: list[Frame]) -> None:
    """A degree of a mount, a percent of a focal length, a few milliseconds: below what trackers and sensors err."""
    for change in (gap(0.1), clock(0.1), holes(0.3), black(0.05)):
        assert examine_frames(sampled(change(good))) == []
    for change in (turned("x", 1.0), late(0.004)):
        assert examine_motion(sampled(change(good)))[0] == []


def test_depth_that_says_the_largest_number_is_told() -> None:
    depth = np.full((1, 10, 10), 1500, np.uint16)
    depth[0, 0, 0] = 65535
    assert not list(full(depth))  # one pixel in a hundred may be chance
    depth[0, 0, 1] = 65535
    (found,) = full(depth)
    assert (found.code, found.figure) == ("depth_missing", "0.020 of the pixels")


@pytest.mark.parametrize(
    ("camera", "wrong"),
    [
        (Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0), ""),
        (Intrinsics(640, 480, 585.0, 585.0, 300.0, 260.0), ""),
        (Intrinsics(640, 480, 585.0, 585.0, 240.0, 320.0), "cx is far from the middle, cy is far from the middle"),
        (Intrinsics(320, 240, 585.0, 585.0, 320.0, 240.0), "cx is far from the middle, cy is far from the middle"),
        (Intrinsics(640, 480, 585.0, 300.0, 319.5, 239.5), "fx and fy are far apart"),
        (Intrinsics(640, 480, 5.0, 5.0, 319.5, 239.5), "the picture would be oddly wide or narrow"),
    ],
)
def test_intrinsics_fit_the_size_of_the_pictures(camera: Intrinsics, wrong: str) -> None:
    findings = list(intrinsics(Rig(camera, camera)))
    assert [one.what for one in findings] == (
        [f"The depth camera's intrinsics do not fit its pictures of {camera.width}x{camera.height}: {wrong}."]
        if wrong
        else []
    )


def test_frames_that_were_left_out_for_their_stamps_are_a_fault_of_the_clock() -> None:
    from openvox.sources import Dropped

    dropped = [Dropped(99, "a stamp that was there already")]
    sample = take_sample([[*tiny_frames(8), *dropped]], 9)
    assert sample is not None
    assert [one.code for one in examine_frames(sample)] == ["clock"]


def test_a_folder_whose_stamps_go_back_is_examined_all_the_same(tmp_path: Path) -> None:
    folder = write_scannet(tmp_path / "scan", tiny_frames(8))
    lines = (folder / "stamps.txt").read_text().split()
    (folder / "stamps.txt").write_text("\n".join([*lines[:4], *lines[:4]]))
    result = doctor(folder)
    assert (result.kind, result.frames) == ("scannet", 8)
    assert [one.code for one in result.findings] == ["clock"]
    assert "--invent-stamps" in result.findings[0].cure
    ingest(folder, tmp_path / "scan.mcap", invent_stamps=True, fps=10.0)
    assert [f.stamp_ns for f in read_frames(tmp_path / "scan.mcap")] == [i * 100_000_000 for i in range(8)]


def test_the_command_prints_findings_and_ends_with_3(
    good: list[Frame], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "bad.mcap", broken(good, "poses inverted"))
    assert run("doctor", str(path), "--json") == 3
    data = json.loads(capsys.readouterr().out)
    assert [set(one) for one in data["findings"]] == [{"code", "what", "figure", "cause", "cure"}]
    assert (data["kind"], data["frames"], data["findings"][0]["code"]) == ("recording", 40, "pose_inverted")
    assert run("doctor", str(written(tmp_path / "good.mcap", good[:12]))) == 0
    assert "nothing looks wrong" in capsys.readouterr().out


def test_ingest_says_what_single_frames_tell(tmp_path: Path) -> None:
    frames = tiny_frames(40)
    good = ingest(write_scannet(tmp_path / "good", frames), tmp_path / "good.mcap")
    assert good.findings == ()
    bad = ingest(write_scannet(tmp_path / "bad", broken(frames, "pictures black")), tmp_path / "bad.mcap")
    assert [one.code for one in bad.findings] == ["black"]
    lost = ingest(write_scannet(tmp_path / "lost", gap(1.0)(frames)), tmp_path / "lost.mcap")
    assert [one.code for one in lost.findings] == ["stamps"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pose_axes": "RDU"}, "camera axes are 'RDU'; expected where x, y and z point"),
        ({"depth_scale": 0.0}, "the depth scale is 0.0; expected 0.0001 to 10000"),
        ({"depth_scale": float("nan")}, "the depth scale is nan"),
        ({"pose_shift": 1e9}, "the pose shift is 1000000000.0 s; expected -60 to 60 s"),
        ({"poses_inverted": True, "origin": (1, 0, 0)}, "--poses-inverted and --origin do not go together"),
    ],
)
def test_corrections_that_make_no_sense_are_refused(tmp_path: Path, options: dict[str, object], message: str) -> None:
    folder = write_scannet(tmp_path / "scan", tiny_frames(3))
    with pytest.raises(InputError, match=message):
        open_source(folder, **options)


def test_a_shift_takes_the_pose_between_two_frames_and_drops_where_there_is_none(tmp_path: Path) -> None:
    """Poses half way between frames of a tenth of a second; the last frame has no pose after it."""
    frames = tiny_frames(4)
    ingest(write_scannet(tmp_path / "scan", frames), tmp_path / "scan.mcap", pose_shift=0.05)
    got = list(read_frames(tmp_path / "scan.mcap"))
    assert [f.index for f in got] == [0, 1, 2]
    for i, frame in enumerate(got):
        between = np.mean([frames[i].world_from_depth.translation, frames[i + 1].world_from_depth.translation], axis=0)
        assert np.allclose(frame.world_from_depth.translation, between, atol=1e-9)
        assert np.array_equal(frame.depth, frames[i].depth)


def test_an_extrinsic_places_the_camera_on_what_the_sources_own_poses_are_of(tmp_path: Path) -> None:
    frames, mount = tiny_frames(3), np.eye(4)
    mount[:3, 3] = (0.1, 0.0, 0.2)
    np.savetxt(tmp_path / "mount.txt", mount)
    ingest(write_scannet(tmp_path / "scan", frames), tmp_path / "a.mcap", extrinsic=tmp_path / "mount.txt")
    for frame, before in zip(read_frames(tmp_path / "a.mcap"), frames, strict=True):
        assert np.allclose(frame.world_from_depth.matrix(), before.world_from_depth.matrix() @ mount, atol=1e-9)


def test_depth_is_scaled_half_to_even_and_what_does_not_fit_is_no_measurement(tmp_path: Path) -> None:
    frames = [replace(f, depth=np.full_like(f.depth, (5, 15, 40000)[i])) for i, f in enumerate(tiny_frames(3))]
    folder = write_scannet(tmp_path / "scan", frames)
    for scale, expected in ((0.1, [0, 2, 4000]), (2.0, [10, 30, 0])):
        ingest(folder, tmp_path / "a.mcap", depth_scale=scale)
        assert [int(f.depth[0, 0]) for f in read_frames(tmp_path / "a.mcap")] == expected


def test_a_map_a_missing_file_and_options_for_a_recording_are_sentences(tmp_path: Path) -> None:
    from maps import small_map

    from openvox.formats.map_npz import write_map

    write_map(tmp_path / "a.map.npz", small_map())
    with pytest.raises(InputError, match="is a map; doctor looks at what a map is made from"):
        doctor(tmp_path / "a.map.npz")
    with pytest.raises(InputError, match="is not there"):
        doctor(tmp_path / "nothing")
    (tmp_path / "text.mcap").write_bytes(b"no file of that kind")
    with pytest.raises(InputError, match=r"text\.mcap"):
        doctor(tmp_path / "text.mcap")
    path = written(tmp_path / "a.mcap", tiny_frames(3))
    for name in ("cut.mcap", "cut.mcap.partial"):
        (tmp_path / name).write_bytes(path.read_bytes()[:2000])
        with pytest.raises(InputError, match="openvox recover"):
            doctor(tmp_path / name)
    with pytest.raises(InputError, match="is a recording, which is read as it is"):
        doctor(path, depth_scale=2.0)
    with pytest.raises(InputError, match="has frames 0 to 2; none of them is asked for"):
        doctor(path, start=7)


def test_a_long_recording_is_looked_at_in_stretches_over_its_length(tmp_path: Path) -> None:
    frames = tiny_frames(1)
    many = [replace(frames[0], index=i, stamp_ns=i * 10**8, color=b"", color_format="") for i in range(1000)]
    result = doctor(written(tmp_path / "a.mcap", many))
    assert (result.frames, result.total) == (400, 1000)
    assert result.findings == ()
    assert "400 of 1000 frames were looked at" in result.notes


def test_a_robots_log_is_examined_as_it_lies(good: list[Frame], tmp_path: Path) -> None:
    from bags import Messages, pictures, robot, write_bag

    make = Messages(ros1=False)
    path = write_bag(tmp_path / "bag", make, [*robot(make, good[:24]), *pictures(make, good[:24])])
    result = doctor(path)
    assert (result.kind, result.frames, result.total, result.findings) == ("ros2", 24, 0, ())
    assert result.notes[0].startswith("colour from ")
    assert [one.code for one in doctor(path, depth_scale=5.0).findings] == ["depth_unit"]


def test_pictures_are_taken_from_all_of_a_log_of_unknown_length(good: list[Frame]) -> None:
    for count, least in ((5, 1), (24, 3), (400, 16)):
        frames = [replace(good[0], index=i, stamp_ns=i + 1) for i in range(count)]
        sample = take_sample([frames], 100)
        assert sample is not None
        assert least <= len(sample.pictures) <= 32
        assert sample.pictures[-1].index >= 0.7 * count - 6


def test_the_same_frames_give_the_same_findings(good: list[Frame]) -> None:
    bad = broken(good[:24], "poses turned 10 deg, z")
    assert found(bad) == found(bad) != ()


def test_options_default_to_no_correction() -> None:
    assert Options() == Options(depth_scale=1.0, pose_axes="RDF", poses_inverted=False, pose_shift=0.0)
    assert CAMERA.width == 32  # the coarse depth of a tiny world is its whole depth
    assert sampled(tiny_frames(2)).depth.shape == (2, 24, 32)


@pytest.mark.parametrize("scene", ["dev_living", "dev_bedroom", "real_kitchen"])
def test_nothing_is_said_of_the_scenes_beside_the_project(shared_data: Path, scene: str) -> None:
    assert doctor(shared_data / scene, start=30, end=60).findings == ()
