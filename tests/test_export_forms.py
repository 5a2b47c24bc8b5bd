"""export as glb, as a grid for navigation and as masks: each opened by a reader that is not openvox."""

from __future__ import annotations

import io
import json
import math
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from maps import META, labelled_map, small_map
from numpy.typing import NDArray
from pycocotools import mask as coco
from ruamel.yaml import YAML
from test_cli import run
from worlds import tiny_frames

from openvox.apps.export import export
from openvox.apps.exporting.mesh import labelled
from openvox.apps.exporting.solids import solids
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.core.colors import instance_color
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.glb import glb
from openvox.formats.map_npz import write_map
from openvox.formats.perception import read_masks
from openvox.formats.ply import ply
from openvox.formats.recording import RecordingWriter, read_frames
from openvox.view.render import render_map
from openvox.view.viewpoint import world_from_color


def exported(result: InstanceMap, folder: Path, name: str, *words: Any, **options: Any) -> dict[str, Any]:
    write_map(folder / "a.map.npz", result)
    return export(folder / "a.map.npz", folder / name, *words, **options)


def opened(data: bytes) -> trimesh.Scene:
    found = trimesh.load_scene(io.BytesIO(data), file_type="glb")
    assert isinstance(found, trimesh.Scene)
    return found


def z_up(scene: trimesh.Scene, node: str) -> trimesh.Trimesh:
    """A node's mesh where it stands, turned back from y up."""
    placed, name = scene.graph[node]
    mesh = scene.geometry[name].copy()
    mesh.apply_transform(placed)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [1, 0, 0]))
    return mesh


# ---- glb -------------------------------------------------------------------------------------------------------------


def test_each_instance_is_a_node_of_its_name_where_it_stands(tmp_path: Path) -> None:
    done = exported(small_map(), tmp_path, "a.glb")
    assert (done["format"], done["instances"]) == ("glb", 2)
    scene = opened((tmp_path / "a.glb").read_bytes())
    assert set(scene.graph.nodes_geometry) == {"a lamp", "ein grüner Stuhl"}
    np.testing.assert_allclose(z_up(scene, "ein grüner Stuhl").bounds, [[0, 0.04, 0], [0.04, 0.08, 0.04]], atol=1e-6)
    np.testing.assert_allclose(z_up(scene, "a lamp").bounds, [[-0.04, 0, 0], [0.04, 0.04, 0.08]], atol=1e-6)


def test_a_node_tells_its_instance_and_has_its_colour(tmp_path: Path) -> None:
    exported(small_map(), tmp_path, "a.glb")
    scene = opened((tmp_path / "a.glb").read_bytes())
    chair = scene.geometry[scene.graph["ein grüner Stuhl"][1]]
    linear = [((x / 255 + 0.055) / 1.055) ** 2.4 for x in instance_color(5)]
    np.testing.assert_allclose(chair.visual.material.baseColorFactor[:3], [255 * x for x in linear], atol=1)
    about = scene.graph.transforms.edge_data["a", "ein grüner Stuhl"]["metadata"]  # of the node, below the root "a"
    assert (about["instance"], about["confidence"], about["voxels"]) == (5, 0.25, 1)


def test_faces_between_voxels_of_an_instance_are_left_out_and_those_outside_look_outwards() -> None:
    block = np.stack(np.meshgrid(range(3), range(2), range(2), indexing="ij"), -1).reshape(-1, 3)
    (solid,) = solids(labelled_map(block, np.full(12, 7), voxel_size=0.5))
    assert len(solid.triangles) == 2 * (2 * 4 + 4 * 6)  # the hull of 3 x 2 x 2, no face within
    mesh = trimesh.Trimesh(solid.vertices, solid.triangles)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(12 * 0.5**3)  # negative if the faces looked inwards


def test_two_instances_that_touch_stay_closed() -> None:
    found = solids(labelled_map(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([3, 4, 0])))
    assert [len(solid.triangles) for solid in found] == [12, 12]


@given(st.sets(st.tuples(*[st.integers(-3, 3)] * 3), min_size=1, max_size=30))
def test_the_solid_has_the_volume_of_its_voxels(cells: set[tuple[int, int, int]]) -> None:
    (solid,) = solids(labelled_map(np.array(sorted(cells)), np.full(len(cells), 1), voxel_size=1.0))
    mesh = trimesh.Trimesh(solid.vertices, solid.triangles, process=False)
    assert mesh.volume == pytest.approx(len(cells), abs=1e-4)
    assert len(np.unique(solid.vertices, axis=0)) == len(solid.vertices)


def test_far_from_the_origin_shapes_keep_their_digits() -> None:
    far = np.array([[1_000_000, -1_000_000, 0]])
    (solid,) = solids(labelled_map(far, np.array([1])))
    assert solid.origin == pytest.approx((40_000.0, -40_000.0, 0.0))
    assert np.ptp(solid.vertices, axis=0) == pytest.approx(0.04)


def test_instances_of_one_name_and_of_none_are_nodes_each(tmp_path: Path) -> None:
    cells = np.array([[0, 0, 0], [2, 0, 0], [4, 0, 0]])
    exported(labelled_map(cells, np.array([1, 2, 3]), captions={1: "a cup", 2: "a cup", 3: ""}), tmp_path, "a.glb")
    scene = opened((tmp_path / "a.glb").read_bytes())
    assert len(scene.graph.nodes_geometry) == 3
    assert "instance 3" in scene.graph.nodes_geometry


def test_a_map_without_instances_is_an_empty_scene(tmp_path: Path) -> None:
    exported(labelled_map(np.zeros((1, 3), int), np.zeros(1, int)), tmp_path, "a.glb")
    assert not opened((tmp_path / "a.glb").read_bytes()).geometry
    assert glb("x", [], "y")[:4] == b"glTF"


# ---- a grid for navigation -------------------------------------------------------------------------------------------


def room() -> InstanceMap:
    """10 x 8 cells of 10 cm: a floor at z = 0 with a hole, a table of four legs' height, a lamp above, a pit."""
    floor = [(x, y, 0) for x in range(10) for y in range(8) if (x, y) not in {(5, 5), (9, 7)}]
    table = [(2, 3, 7), (3, 3, 7)]
    lamp = [(7, 1, 19)]
    sill = [(4, 6, 1)]
    pit = [(9, 7, -6)]
    cells = np.array([*floor, *table, *lamp, *sill, *pit])
    return labelled_map(cells, np.array([0] * len(floor) + [1, 1, 2, 0, 0]), voxel_size=0.1)


def read_grid(path: Path) -> tuple[dict[str, Any], NDArray[np.int8]]:
    """As ROS map_server reads it: the YAML, and cells [y, x] of 100 = occupied, 0 = free, -1 = unknown."""
    about = YAML(typ="safe").load(path)
    assert (about["mode"], about["negate"]) == ("trinary", 0)
    grey = cv2.imread(str(path.parent / about["image"]), cv2.IMREAD_UNCHANGED)
    assert grey is not None
    assert grey.dtype == np.uint8
    share = (255 - grey[::-1].astype(float)) / 255
    cells = np.full(share.shape, -1, np.int8)
    cells[share > about["occupied_thresh"]] = 100
    cells[share < about["free_thresh"]] = 0
    return about, cells


def test_a_grid_has_what_stands_in_the_way_the_seen_floor_and_the_unknown(tmp_path: Path) -> None:
    done = exported(room(), tmp_path, "a.yaml", "occupancy")
    about, cells = read_grid(tmp_path / "a.yaml")
    assert about["resolution"] == 0.1
    assert about["origin"] == [0, 0, 0]
    assert cells.shape == (8, 10)
    assert done["floor"] == pytest.approx(0.05)
    expected = np.zeros((8, 10), np.int8)
    expected[3, 2:4] = 100  # the table
    expected[5, 5] = -1  # nobody saw it
    expected[7, 9] = 100  # a pit
    np.testing.assert_array_equal(cells, expected)  # the lamp is above, the sill below what stops
    assert done["cells"] == {"free": 76, "occupied": 3, "unknown": 1}


def test_a_small_robot_drives_under_the_table_and_a_tall_one_hits_the_lamp(tmp_path: Path) -> None:
    exported(room(), tmp_path, "a.yaml", "occupancy", assignments=["occupancy.obstacle_high=0.5"])
    assert not (read_grid(tmp_path / "a.yaml")[1][3] == 100).any()
    exported(room(), tmp_path, "a.yaml", "occupancy", assignments=["occupancy.obstacle_high=2"])
    assert read_grid(tmp_path / "a.yaml")[1][1, 7] == 100


def test_floor_and_drops_can_be_told(tmp_path: Path) -> None:
    words = ["occupancy.find_floor=false", "occupancy.floor_height=-0.6", "occupancy.obstacle_low=0.7"]
    done = exported(room(), tmp_path, "a.yaml", "occupancy", assignments=words)
    assert done["floor"] == -0.6
    assert read_grid(tmp_path / "a.yaml")[1][7, 9] == 0
    exported(room(), tmp_path, "a.yaml", "occupancy", assignments=["occupancy.drops=false"])
    assert read_grid(tmp_path / "a.yaml")[1][7, 9] == 0


def test_a_map_below_and_left_of_zero_keeps_its_place(tmp_path: Path) -> None:
    exported(
        labelled_map(np.array([[-3, -2, 0], [0, 1, 0]]), np.zeros(2, int), voxel_size=0.5),
        tmp_path,
        "b's.yaml",
        "occupancy",
    )
    about, cells = read_grid(tmp_path / "b's.yaml")
    assert about["origin"] == [-1.5, -1.0, 0]
    np.testing.assert_array_equal(np.argwhere(cells == 0), [[0, 0], [3, 3]])


def test_what_no_grid_can_be_made_of_is_refused_and_nothing_is_left(tmp_path: Path) -> None:
    empty = labelled_map(np.zeros((0, 3), int), np.zeros(0, int))
    with pytest.raises(InputError, match="the map has no voxels"):
        exported(empty, tmp_path, "a.yaml", "occupancy")
    wide = labelled_map(np.array([[0, 0, 0], [1_000_000, 1_000_000, 0]]), np.zeros(2, int))
    with pytest.raises(InputError, match="1000001 x 1000001 voxels wide"):
        exported(wide, tmp_path, "a.yaml", "occupancy")
    with pytest.raises(InputError, match=r"obstacle_low is 0.1 m, occupancy.obstacle_high 0.05 m"):
        exported(room(), tmp_path, "a.yaml", "occupancy", assignments=["occupancy.obstacle_high=0.05"])
    assert [path.name for path in tmp_path.iterdir()] == ["a.map.npz"]


# ---- masks -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def mapped(tmp_path: Path) -> Path:
    """A tiny world, recorded and mapped; the map's path."""
    with RecordingWriter(tmp_path / "tiny.mcap", source="test", categories={1: "box", 2: "ball"}) as writer:
        for frame in tiny_frames(3):
            writer.add(frame)
    perceive(tmp_path / "tiny.mcap", frontend="oracle", assignments=["oracle.min_pixels=1"])
    replay(tmp_path / "tiny.mcap", preset_name="paper", assignments=["masks.min_pixels=0"])
    return tmp_path / "tiny.map.npz"


@pytest.mark.filterwarnings("ignore:__array__ implementation")  # of pycocotools
def test_masks_are_what_the_cameras_see_of_the_map(mapped: Path, tmp_path: Path) -> None:
    from openvox.formats.map_npz import read_map

    out = tmp_path / "map.detections.jsonl"
    done = export(mapped, out, "masks", assignments=["rendered.min_pixels=1"])
    lines = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    assert [line["frame"] for line in lines] == [0, 1, 2]
    assert done["frames"] == 3
    assert done["masks"] == sum(len(line["detections"]) for line in lines) > 0
    result = read_map(mapped)
    for line, frame in zip(lines, read_frames(tmp_path / "tiny.mcap"), strict=True):
        seen = render_map(
            result.voxel_index, result.voxel_instance, result.voxel_size, world_from_color(frame), frame.rig.color
        )
        assert [one["instance"] for one in line["detections"]] == sorted(set(seen[seen > 0].tolist()))
        for one in line["detections"]:
            size, counts = one["mask"]["size"], one["mask"]["counts"].encode()
            bitmap = coco.decode({"size": size, "counts": counts}).astype(bool)
            np.testing.assert_array_equal(bitmap, seen == one["instance"])
            x, y, width, height = coco.toBbox({"size": size, "counts": counts}).tolist()
            assert one["box"] == [x, y, x + width, y + height]


def test_perceive_reads_them_back(mapped: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.detections.jsonl"
    done = export(mapped, out, "masks", assignments=["rendered.min_pixels=1"])
    perceived = perceive(tmp_path / "tiny.mcap", detections=out, out=tmp_path / "again.perception.mcap")
    assert perceived.masks == done["masks"]
    first = next(read_masks(tmp_path / "again.perception.mcap"))
    line = json.loads(out.read_text(encoding="utf-8").splitlines()[0])
    assert [mask.caption for mask in first.masks] == [one["caption"] for one in line["detections"]]


def test_few_pixels_are_no_mask(mapped: Path, tmp_path: Path) -> None:
    assert export(mapped, tmp_path / "a.jsonl", "masks", assignments=["rendered.min_pixels=1000000"])["masks"] == 0
    assert [json.loads(line)["detections"] for line in (tmp_path / "a.jsonl").read_text().splitlines()] == [[]] * 3


def test_a_map_whose_recording_is_gone_or_another_says_so(mapped: Path, tmp_path: Path) -> None:
    (tmp_path / "tiny.mcap").rename(tmp_path / "moved.mcap")
    with pytest.raises(InputError, match="is not there, or is another one now; name it with --recording"):
        export(mapped, tmp_path / "a.jsonl", "masks")
    assert export(mapped, tmp_path / "a.jsonl", "masks", recording=tmp_path / "moved.mcap")["frames"] == 3
    other = labelled_map(np.zeros((1, 3), int), np.ones(1, int), meta={**META, "digests": {"recording": "ab"}})
    write_map(tmp_path / "other.map.npz", other)
    with pytest.raises(InputError, match="is not the recording of"):
        export(tmp_path / "other.map.npz", tmp_path / "b.jsonl", "masks", recording=tmp_path / "moved.mcap")
    assert not (tmp_path / "b.jsonl").exists()


# ---- a surface -------------------------------------------------------------------------------------------------------


def read_mesh(path: Path) -> trimesh.Trimesh:
    mesh = trimesh.load_mesh(path, process=False)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def test_vertices_take_what_the_voxel_says_in_which_they_lie_or_the_nearest(tmp_path: Path) -> None:
    result = labelled_map(np.array([[0, 0, 0], [5, 0, 0]]), np.array([7, 0]), voxel_size=0.1, voxel_confidence=0.75)
    places = np.array([[0.05, 0.05, 0.05], [0.05, 0.05, 0.14], [0.55, 0.05, 0.05], [0.3, 0.3, 0.3]])
    (tmp_path / "a.ply").write_bytes(ply(labelled(places, result), np.array([[0, 1, 2], [2, 1, 3]], np.int32), "test"))
    mesh = read_mesh(tmp_path / "a.ply")
    np.testing.assert_allclose(mesh.vertices, places, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [2, 1, 3]])
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert raw["instance"].tolist() == [7, 7, 0, 0]
    assert raw["confidence"].tolist() == [0.75, 0.75, 0.75, 0]
    colors = [(*instance_color(number), 255) for number in (7, 7, 0, 0)]
    np.testing.assert_array_equal(mesh.visual.vertex_colors, colors)


def test_a_surface_lies_where_the_depth_is(mapped: Path, tmp_path: Path) -> None:
    pytest.importorskip("open3d", reason='the extra "mesh" is not installed')
    done = export(mapped, tmp_path / "a.ply", "mesh", assignments=["mesh.min_frames=1", "mesh.truncation=0.3"])
    mesh = read_mesh(tmp_path / "a.ply")
    assert (len(mesh.vertices), len(mesh.faces)) == (done["vertices"], done["triangles"])
    frame = next(read_frames(tmp_path / "tiny.mcap"))
    assert len(mesh.faces) > 0
    eye = frame.world_from_depth.matrix()
    depth = (mesh.vertices - eye[:3, 3]) @ eye[:3, 2]
    measured = frame.depth[frame.depth > 0] / 1000
    assert measured.min() - 0.3 < np.median(depth) < measured.max() + 0.3


def test_a_surface_without_its_extra_is_one_sentence(
    mapped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(InputError, match=r'pip install "openvox\[mesh\]"'):
        export(mapped, tmp_path / "a.ply", "mesh")
    assert not list(tmp_path.glob("a.ply*"))


# ---- what is asked for -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "what", "options", "sentence"),
    [
        ("a.pgm", "occupancy", {}, r"a.pgm ends in .pgm; expected .yaml, which"),
        ("a.yaml", "map", {}, r"expected .ply, .glb, .csv or .jsonl"),
        ("a.yaml", "masks", {}, r"expected .jsonl"),
        ("a.glb", "map", {"assignments": ["occupancy.drops=false"]}, "occupancy.drops has no effect"),
        ("a.yaml", "occupancy", {"assignments": ["rendered.min_pixels=9"]}, "rendered.min_pixels has no effect"),
        ("a.yaml", "occupancy", {"assignments": ["occupancy.drop_depht=9"]}, "did you mean occupancy.drop_depth"),
        ("a.glb", "map", {"recording": Path("x.mcap")}, "--recording x.mcap has no effect"),
    ],
)
def test_what_makes_no_sense_is_refused_before_the_map_is_read(
    tmp_path: Path, name: str, what: Any, options: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        export(tmp_path / "missing.npz", tmp_path / name, what, **options)


def test_the_command_writes_each_form_and_refuses_two_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_map(tmp_path / "a.map.npz", room())
    assert run("export", tmp_path / "a.map.npz", tmp_path / "a.yaml", "--occupancy") == 0
    assert "76 free, 3 occupied, 1 unknown" in capsys.readouterr().out
    assert run("export", tmp_path / "a.map.npz", tmp_path / "a.yaml", "--occupancy", "--json") == 0
    assert json.loads(capsys.readouterr().out)["replaced"]
    assert run("export", tmp_path / "a.map.npz", tmp_path / "a.jsonl", "--occupancy", "--masks") == 2
