"""Truth as ScanNet and Replica ship it: small files of their layouts, and what evaluate makes of them."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maps import labelled_map

from openvox.apps.evaluate import evaluate
from openvox.apps.sweeping.plan import truth_digest
from openvox.core.errors import InputError
from openvox.formats.map_npz import write_map
from openvox.formats.ply import read_ply
from openvox.formats.truth import read_truth


def ply(vertices: list[tuple[float, float, float]], faces: list[tuple[tuple[int, ...], int]] | None = None) -> bytes:
    """A mesh with colours, as both data sets have them; faces with object_id, as Replica's."""
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    body = b"".join(struct.pack("<3f3B", *vertex, 1, 2, 3) for vertex in vertices)
    if faces is not None:
        head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nproperty int object_id\n"
        body += b"".join(struct.pack(f"<B{len(corners)}ii", len(corners), *corners, o) for corners, o in faces)
    return (head + "end_header\n").encode() + body


@pytest.fixture
def scannet(tmp_path: Path) -> Path:
    """Six vertices in four segments: a wall, a chair of two segments, and something that nobody annotated."""
    folder = tmp_path / "scene0000_00"
    folder.mkdir()
    (folder / "scene0000_00_vh_clean_2.ply").write_bytes(ply([(0.1 * i, 0.0, 1.0) for i in range(6)]))
    segments = {"segIndices": [7, 7, 3, 3, 12, 99]}
    (folder / "scene0000_00_vh_clean_2.0.010000.segs.json").write_text(json.dumps(segments))
    groups = [
        {"id": 0, "objectId": 0, "segments": [7], "label": "wall"},
        {"id": 1, "objectId": 4, "segments": [3, 12], "label": "office chair"},
    ]
    text = json.dumps({"sceneId": "scannet.scene0000_00", "segGroups": groups})
    (folder / "scene0000_00.aggregation.json").write_text(text)
    (folder / "scene0000_00_vh_clean.aggregation.json").write_text("another mesh's, which must not be taken")
    return folder


def test_scannets_annotations_become_points_with_instances(scannet: Path) -> None:
    truth = read_truth(scannet)
    np.testing.assert_allclose(truth.points[:, 0], [0.0, 0.1, 0.2, 0.3, 0.4, 0.5], atol=1e-7)
    assert truth.instance.tolist() == [0, 0, 5, 5, 5, 0]
    assert truth.category is not None
    assert truth.category.tolist() == [2, 2, 1, 1, 1, 0]
    assert dict(truth.categories) == {1: "office chair", 2: "wall"}
    assert [(one.id, one.name) for one in truth.objects] == [(5, "office chair 5")]


@pytest.mark.parametrize("beside", [True, False])
def test_with_scannets_table_of_labels_the_categories_are_nyu40s(scannet: Path, beside: bool) -> None:
    table = "id\traw_category\tnyu40id\tnyu40class\n2\toffice chair\t5\tchair\n1\twall\t1\twall\n9\todd\t\t\n"
    (scannet if beside else scannet.parent).joinpath("scannetv2-labels.combined.tsv").write_text(table)
    truth = read_truth(scannet)
    assert truth.category is not None
    assert truth.category.tolist() == [1, 1, 5, 5, 5, 0]
    assert dict(truth.categories) == {1: "wall", 5: "chair"}


def test_queries_of_ones_own_lie_beside_them(scannet: Path) -> None:
    asked = {"queries": [{"type": "ontology", "text": "a chair", "instances": [5]}]}
    (scannet / "queries.json").write_text(json.dumps(asked))
    assert read_truth(scannet).queries[0].instances == (5,)


def write(name: str, text: str) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_text(text)


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (write("scene0000_00.aggregation.json", "{"), "is no JSON"),
        (write("scene0000_00.aggregation.json", "{}"), 'has no list "segGroups"'),
        (write("scene0000_00.aggregation.json", '{"segGroups": [{"objectId": 1}]}'), "segGroups 0 has no"),
        (
            write("scene0000_00.aggregation.json", '{"segGroups": [{"objectId": 1, "label": "a", "segments": "b"}]}'),
            "segments of group 0 is no list of whole numbers",
        ),
        (write("scene0000_00_vh_clean_2.0.010000.segs.json", '{"segIndices": [1, 2]}'), "has 2 segments"),
        (write("scene0000_00_vh_clean_2.0.010000.segs.json", '{"segIndices": [0.5]}'), "no list of whole numbers"),
        (write("scene0000_00_vh_clean_2.ply", "obj"), "is no PLY file"),
        (write("scannetv2-labels.combined.tsv", "a\tb\n1\t2\n"), "scannetv2-labels.combined.tsv cannot be read"),
    ],
)
def test_what_is_wrong_in_scannets_files_is_one_sentence(
    scannet: Path, damage: Callable[[Path], Any], expected: str
) -> None:
    damage(scannet)
    with pytest.raises(InputError, match=expected):
        read_truth(scannet)


@pytest.fixture
def replica(tmp_path: Path) -> Path:
    """Three quads: of a sofa (object 3), of a wall (object 1) and of nothing (object 0, class -1)."""
    folder = tmp_path / "room_0" / "habitat"
    folder.mkdir(parents=True)
    corners = [
        (x + dx, y, z + dz)
        for x, y, z in ((0, 0, 0), (1, 0, 0), (2, 0, 0))
        for dx, dz in ((0, 0), (0.2, 0), (0.2, 0.2), (0, 0.2))
    ]
    quads = [tuple(range(4 * i, 4 * i + 4)) for i in range(3)]
    (folder / "mesh_semantic.ply").write_bytes(ply(corners, list(zip(quads, (3, 1, 0), strict=True))))
    content = {
        "classes": [{"id": 76, "name": "sofa"}, {"id": 93, "name": "wall"}],
        "objects": [
            {"id": 3, "class_id": 76, "class_name": "sofa"},
            {"id": 1, "class_id": 93, "class_name": "wall"},
            {"id": 0, "class_id": -1, "class_name": "undefined"},
        ],
    }
    (folder / "info_semantic.json").write_text(json.dumps(content))
    return folder.parent


@pytest.mark.parametrize("inner", [True, False])
def test_replicas_faces_become_points_with_instances(replica: Path, inner: bool) -> None:
    truth = read_truth(replica / "habitat" if inner else replica)
    np.testing.assert_allclose(truth.points, [[0.1, 0, 0.1], [1.1, 0, 0.1], [2.1, 0, 0.1]], atol=1e-6)
    assert truth.category is not None
    assert (truth.instance.tolist(), truth.category.tolist()) == ([4, 0, 0], [76, 93, 0])
    assert dict(truth.categories) == {76: "sofa", 93: "wall"}
    assert [(one.id, one.name) for one in truth.objects] == [(4, "sofa 4")]


def test_of_replicas_fine_mesh_one_point_a_cell_and_object_is_kept(replica: Path) -> None:
    tiny = [(0.001 * i, 0.0, 0.0) for i in range(4)]
    faces = [((0, 1, 2, 3), 3), ((0, 1, 2, 3), 3), ((0, 1, 2, 3), 1)]
    (replica / "habitat" / "mesh_semantic.ply").write_bytes(ply(tiny, faces))
    assert read_truth(replica).instance.tolist() == [4, 0]


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (write("info_semantic.json", "{}"), '"classes" cannot be read'),
        (write("info_semantic.json", '{"classes": [], "objects": [{"id": 1}]}'), '"objects" cannot be read'),
        (lambda f: (f / "mesh_semantic.ply").write_bytes(ply([(0, 0, 0)])), "has no faces with vertex_indices"),
        (
            lambda f: (f / "mesh_semantic.ply").write_bytes(ply([(0, 0, 0)], [((0, 0, 9), 1)])),
            "a face names vertex 9 of 1",
        ),
        (
            lambda f: (f / "mesh_semantic.ply").write_bytes(ply([(0, 0, 0)] * 4, [((0, 1, 2, 3), 1), ((0, 1, 2), 1)])),
            "do not fit|unequal lengths",
        ),
        (
            lambda f: (f / "mesh_semantic.ply").write_bytes(
                ply([(0, 0, 0)], [((256, 0, 0), 1)]).replace(b"list uchar", b"list int32")
            ),
            "a face has a list of",
        ),
        (lambda f: (f / "mesh_semantic.ply").write_bytes(ply([(0, 0, np.nan)], [((0, 0, 0), 1)])), "is not finite"),
    ],
)
def test_what_is_wrong_in_replicas_files_is_one_sentence(
    replica: Path, damage: Callable[[Path], Any], expected: str
) -> None:
    damage(replica / "habitat")
    with pytest.raises(InputError, match=expected):
        read_truth(replica)


def test_numbers_of_objects_may_be_large(replica: Path) -> None:
    quad = [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.2, 0.0, 0.2), (0.0, 0.0, 0.2)]
    faces = [((0, 1, 2, 3), number) for number in (2**31 - 1, 3, -1)]
    (replica / "habitat" / "mesh_semantic.ply").write_bytes(ply(quad, faces))
    assert read_truth(replica).instance.tolist() == [0, 4]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (b"element vertex 1", b"element vertex 1000000000", "do not fit|is it whole"),
        (b"element vertex 1", b"element vertex -1", "do not fit"),
        (b"property float x", b"property double128 x", "which is not understood"),
        (b"property float y", b"property float x", "vertex cannot be read"),
        (b"property float x", b"property list float float x", "vertex cannot be read"),
        (b"binary_little_endian", b"ascii", "is ascii; expected binary_little_endian"),
        (b"end_header", b"end_of_it", "is no PLY file"),
    ],
)
def test_hostile_headers_of_meshes_cost_nothing(tmp_path: Path, old: bytes, new: bytes, expected: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply([(np.nan, 0, 0)]).replace(old, new))
    with pytest.raises(InputError, match=expected):
        read_ply(tmp_path / "a.ply")


def test_a_sweep_knows_such_a_folder_by_its_points_and_instances(scannet: Path) -> None:
    before = truth_digest(scannet)
    assert truth_digest(scannet) == before
    write("scene0000_00_vh_clean_2.0.010000.segs.json", json.dumps({"segIndices": [7, 7, 7, 3, 12, 99]}))(scannet)
    assert truth_digest(scannet) != before


def test_a_map_is_scored_against_such_a_folder(scannet: Path, tmp_path: Path) -> None:
    """A map that has the chair's place as one instance, of voxels of 10 cm: every object point is found."""
    points = np.array([[0.1 * i + 0.05, 0.0, 1.0] for i in range(40)])
    (scannet / "scene0000_00_vh_clean_2.ply").write_bytes(ply([tuple(point) for point in points.tolist()]))
    segments = {"segIndices": [3] * 20 + [7] * 20}
    (scannet / "scene0000_00_vh_clean_2.0.010000.segs.json").write_text(json.dumps(segments))
    index = np.floor(points / 0.1).astype(np.int32)
    write_map(tmp_path / "a.map.npz", labelled_map(index, np.array([1] * 20 + [0] * 20), voxel_size=0.1))
    scores = evaluate(tmp_path / "a.map.npz", truth=scannet)
    assert (scores["instances"]["ap50"], scores["instances"]["true"]) == (1.0, 1)
    assert scores["objects"][0]["name"] == "office chair 5"
