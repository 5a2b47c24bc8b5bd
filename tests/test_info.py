"""info: what a file is, whatever its name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from maps import small_map
from worlds import CAMERA, tiny_frames

from openvox.apps.info import info, kind_of, parameters
from openvox.apps.view import as_rrd
from openvox.cli.commands.info import print_file
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import MapperParameters
from openvox.core.parameters import as_dict
from openvox.core.types import Mask
from openvox.formats.map_npz import write_map
from openvox.formats.mcap_io import McapWriter, Topic
from openvox.formats.perception import FrameMasks, PerceptionWriter, perception_info
from openvox.formats.recording import RecordingWriter, recording_info


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "a file without an ending"
    with RecordingWriter(path, source="test", categories={7: "table"}) as writer:
        for frame in tiny_frames(3):
            writer.add(frame)
        writer.drop(9, "pose is not finite")
    return path


def test_a_recording_is_known_by_its_topics(recording: Path) -> None:
    found = info(recording)
    assert (found["kind"], found["frames"], found["first"], found["last"]) == ("recording", 3, 0, 2)
    assert found["digest"] == recording_info(recording).digest
    assert (found["has_color"], found["has_truth"], found["categories"], found["registered"]) == (True, True, 1, True)
    assert found["dropped"] == {"pose is not finite": 1}
    assert found["depth_camera"]["width"] == CAMERA.width
    json.dumps(found, allow_nan=False)


def test_a_perception_file_is_known_by_its_topics(recording: Path, tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    stage = {"role": "Enc", "name": "minilm", "parameters": {}, "model_digest": "ab"}
    with PerceptionWriter(path, recording_info(recording), stages=[stage], encoder="minilm", dimensions=1) as writer:
        mask = Mask.from_bitmap(np.ones((2, 2), np.bool_), embedding=np.ones(1, np.float32))
        writer.add(FrameMasks(1, 5, "0" * 64, (mask, mask), (24, 32)))
    found = info(path)
    assert (found["kind"], found["frames"], found["masks"], found["encoder"]) == ("perception", 1, 2, "minilm")
    assert found["digest"] == perception_info(path).digest
    assert (found["recording"], found["kinds"], found["stages"]) == (recording.name, {"object": 2}, [stage])
    json.dumps(found, allow_nan=False)


def test_a_map_is_known_by_its_first_bytes(tmp_path: Path) -> None:
    write_map(tmp_path / "map", small_map())
    found = info(tmp_path / "map")
    assert found["kind"] == "map"
    assert found["digest"] == map_digest(small_map())
    counts = [found[name] for name in ("voxels", "votes", "fragments", "instances", "dimensions")]
    assert counts == [4, 6, 3, 2, 3]
    assert found["bounds"] == [pytest.approx([-0.04, 0, 0]), pytest.approx([0.16, 0.08, 0.08])]
    assert (found["preset"], found["digests"]["recording"], found["voxel_size"]) == ("openvox", "ab", 0.04)
    json.dumps(found, allow_nan=False)


def test_a_file_of_rerun_is_known_by_its_first_bytes(tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", small_map())
    found = info(as_rrd(tmp_path / "a.map.npz", tmp_path / "a.rrd"))
    assert (found["kind"], found["application"], found["timelines"]) == ("rrd", "openvox map", {})
    assert len(found["recording_ids"]) == 1
    assert found["entities"] >= len(found["largest"]) > 0
    assert found["bytes"] == (tmp_path / "a.rrd").stat().st_size
    assert found["unpacked_bytes"] >= sum(found["largest"].values())


def test_what_is_none_of_ours_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("hello you")
    (tmp_path / "empty").touch()
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with McapWriter(tmp_path / "other.mcap") as writer:
        writer.add(Topic("/chatter", "json", "", "", b""), 0, 0, b"{}")
    for name, sentence in (
        ("text", r"is a text file; expected a recording, perception or trace \(MCAP\), or a map"),
        ("empty", r"is empty"),
        ("missing", r"cannot be read \(No such file"),
        (".", r"cannot be read \(Is a directory"),
        ("other.npz", r"is no map file"),
        ("other.mcap", r"has topics under chatter; openvox writes no such file"),
    ):
        with pytest.raises(InputError, match=sentence):
            info(tmp_path / name)


@pytest.mark.parametrize(
    ("topics", "kind"),
    [(["/rosout", "/camera/depth", "chatter"], "recording"), (["/mapper/decisions", "/mapper/events"], "trace")],
)
def test_topics_of_others_do_not_matter(tmp_path: Path, topics: list[str], kind: str) -> None:
    with McapWriter(tmp_path / "a.mcap") as writer:
        for name in topics:
            writer.add(Topic(name, "json", "", "", b""), 0, 0, b"{}")
    assert kind_of(tmp_path / "a.mcap") == kind


def test_all_parameters_are_listed_with_unit_range_and_reason() -> None:
    rows = parameters()["parameters"]
    assert {row["name"] for row in rows if row["command"] == "replay"} == set(as_dict(MapperParameters()))
    assert any(row["command"] == "perceive" for row in rows)
    (row,) = (row for row in rows if row["name"] == "map.voxel_size")
    assert (row["default"], row["unit"], row["range"]) == (0.04, "m", "0.002 .. 1")
    assert all(row["why"] and row["range"] for row in rows)
    json.dumps(rows, allow_nan=False)


def test_the_masks_of_a_perception_file_are_summed_up(recording: Path, tmp_path: Path, capsys) -> None:
    path = tmp_path / "b.mcap"
    stage = {"role": "enc", "name": "minilm", "parameters": {}, "model_digest": "ab"}
    unit = np.ones(1, np.float32)

    def mask(side: int, score: float, caption: str, named: bool = True) -> Mask:
        bitmap = np.ones((side, side), np.bool_)
        return Mask.from_bitmap(bitmap, score=score, caption_score=1.0, caption=caption, named=named, embedding=unit)

    found = [
        (mask(5, 0.31, "a cup"), mask(10, 0.3, "a cup"), mask(15, 0.59, "a grey object", named=False)),
        (),
        (mask(20, 1.0, "a cup"),),
    ]
    with PerceptionWriter(path, recording_info(recording), stages=[stage], encoder="minilm", dimensions=1) as writer:
        for i, masks in enumerate(found):
            writer.add(FrameMasks(i, 5 + i, "0" * 64, masks, (24, 32)))
    data = info(path)
    assert data["masks_a_frame"] == {"least": 0, "mean": 4 / 3, "most": 3}
    assert (data["frames_without_masks"], data["named"], data["captions"]) == (1, 3, 2)
    assert [(row["from"], row["masks"]) for row in data["scores"] if row["masks"]] == [(0.3, 2), (0.5, 1), (1.0, 1)]
    assert data["scores"][1] == {"from": 0.4, "masks": 0}
    assert [(row["from"], row["masks"]) for row in data["areas"]] == [(0, 1), (100, 2), (400, 1)]
    assert data["most_common"] == [
        {"caption": "a cup", "named": True, "masks": 3},
        {"caption": "a grey object", "named": False, "masks": 1},
    ]
    print_file(data)
    printed = capsys.readouterr().out
    assert "  from      100         2  " + "#" * 40 + "\n" in printed
    assert "a grey object" in printed


def test_a_perception_file_without_masks_has_empty_histograms(recording: Path, tmp_path: Path, capsys) -> None:
    path = tmp_path / "b.mcap"
    with PerceptionWriter(path, recording_info(recording), stages=[], encoder="minilm", dimensions=1) as writer:
        writer.add(FrameMasks(1, 5, "0" * 64, (), (24, 32)))
    data = info(path)
    assert (data["scores"], data["areas"], data["most_common"]) == ([], [], [])
    print_file(data)
    assert "areas\n" in capsys.readouterr().out
