"""export: what other programs read."""

from __future__ import annotations

import csv
import json
import struct
from pathlib import Path
from typing import Any

import pytest
from maps import labelled_map, small_map

from openvox.apps.export import export
from openvox.core.colors import GREY, instance_color
from openvox.core.errors import InputError, OutputError
from openvox.formats.map_npz import write_map

SIZES = {"float": ("<f", 4), "uchar": ("<B", 1), "int": ("<i", 4)}


def read_ply(path: Path) -> list[dict[str, Any]]:
    """Vertices of a PLY file, by the letter of the format, without numpy."""
    head, end, body = path.read_bytes().partition(b"end_header\n")
    assert end
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    fields = [line.split() for line in lines[2:] if not line.startswith("comment ")]
    (element, name, count), properties = fields[0], fields[1:]
    assert (element, name) == ("element", "vertex")
    assert all(words[0] == "property" and len(words) == 3 for words in properties)
    vertices, at = [], 0
    for _ in range(int(count)):
        vertex = {}
        for _, kind, key in properties:
            form, size = SIZES[kind]
            vertex[key] = struct.unpack_from(form, body, at)[0]
            at += size
        vertices.append(vertex)
    assert at == len(body)
    return vertices


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    write_map(tmp_path / "a.map.npz", small_map())
    return tmp_path / "a.map.npz"


def test_ply_has_a_coloured_point_for_every_voxel_of_an_instance(map_file: Path, tmp_path: Path) -> None:
    result = export(map_file, tmp_path / "a.ply")
    assert result == {
        "output": str(tmp_path / "a.ply"),
        "format": "ply",
        "instances": 2,
        "voxels": 3,
        "replaced": False,
    }
    vertices = read_ply(tmp_path / "a.ply")
    assert [vertex["instance"] for vertex in vertices] == [2, 2, 5]  # background is left out
    assert [vertices[0][axis] for axis in "xyz"] == pytest.approx([-0.02, 0.02, 0.02])
    assert [vertices[2][axis] for axis in "xyz"] == pytest.approx([0.02, 0.06, 0.02])
    assert [vertex["confidence"] for vertex in vertices] == pytest.approx([2 / 3, 1, 1])
    for vertex in vertices:
        assert tuple(vertex[color] for color in ("red", "green", "blue")) == instance_color(vertex["instance"])
    assert len(vertices[0]) == 8


def test_csv_has_a_row_for_every_instance(map_file: Path, tmp_path: Path) -> None:
    export(map_file, tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        lamp, chair = csv.DictReader(file)
    assert (lamp["id"], lamp["caption"], lamp["observations"], lamp["confidence"]) == ("2", "a lamp", "3", "0.5")
    assert (chair["caption"], chair["state"], chair["voxels"]) == ("ein grüner Stuhl", "confirmed", "1")
    assert [float(lamp[f"center_{axis}"]) for axis in "xyz"] == pytest.approx([0.0, 0.02, 0.04])
    assert [float(lamp[f"max_{axis}"]) for axis in "xyz"] == [0.04, 0.04, 0.04]


@pytest.mark.parametrize("caption", ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1 "])
def test_csv_holds_no_formula(tmp_path: Path, caption: str) -> None:
    result = small_map()
    write_map(tmp_path / "a.map.npz", labelled_map(result.voxel_index, result.voxel_instance, captions={2: caption}))
    export(tmp_path / "a.map.npz", tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        assert [row["caption"] for row in csv.DictReader(file)] == [f"'{caption.strip()}", "thing 5"]


def test_jsonl_has_an_object_for_every_instance(map_file: Path, tmp_path: Path) -> None:
    export(map_file, tmp_path / "a.jsonl")
    lamp, chair = map(json.loads, (tmp_path / "a.jsonl").read_text(encoding="utf-8").splitlines())
    assert (lamp["instance"], lamp["caption"], lamp["captions"]) == (2, "a lamp", [["a lamp", 2.0]])
    assert chair["bounds"] == [[0, 0, 0], [0.04, 0.04, 0.04]]
    assert chair["center"] == pytest.approx([0.02, 0.06, 0.02])
    assert chair["confidence"] == 0.25


def test_a_map_without_instances_exports_nothing_in_good_form(tmp_path: Path) -> None:
    result = small_map()
    write_map(tmp_path / "a.map.npz", labelled_map(result.voxel_index, result.voxel_instance * 0))
    for name in ("a.ply", "a.csv", "a.jsonl"):
        assert export(tmp_path / "a.map.npz", tmp_path / name)["instances"] == 0
    assert read_ply(tmp_path / "a.ply") == []
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 1
    assert (tmp_path / "a.jsonl").read_text() == ""


def test_an_unknown_ending_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a.obj ends in .obj; expected .ply, .glb, .csv or .jsonl"):
        export(tmp_path / "missing.npz", tmp_path / "a.obj")
    with pytest.raises(InputError, match="ends in nothing"):
        export(tmp_path / "missing.npz", tmp_path / "a")


def test_an_older_file_is_replaced_and_said_so_but_kept_if_the_map_is_bad(map_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.csv"
    out.write_text("old")
    with pytest.raises(InputError):
        export(tmp_path / "missing.npz", out)
    assert out.read_text() == "old"
    assert export(map_file, out)["replaced"]
    with pytest.raises(OutputError, match="could not be written"):
        export(map_file, tmp_path / "no" / "folder.csv")


def test_colours_stay_the_same_and_neighbours_differ() -> None:
    assert [instance_color(i) for i in (0, 1, 2)] == [GREY, (121, 156, 242), (146, 242, 12)]
    colors = [instance_color(i) for i in range(1, 200)]
    for i, color in enumerate(colors):
        for other in colors[i + 1 : i + 5]:
            assert sum(abs(a - b) for a, b in zip(color, other, strict=True)) > 60
