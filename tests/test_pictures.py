"""Pictures without a screen: what is drawn, in which colour, and where the names stand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from maps import labelled_map, small_map
from numpy.typing import NDArray
from worlds import tiny_frames

from openvox.core.colors import instance_color
from openvox.core.errors import OutputError
from openvox.core.types import Decision, Intrinsics, Mask, Pose
from openvox.view.labels import UNASSIGNED, Captions, mask_image, shortened
from openvox.view.lettering import Note, annotate, place
from openvox.view.pictures import MARGIN, PAPER, TITLE, draw_frame, draw_map
from openvox.view.render import render_rows
from openvox.view.shading import EDGE, LIGHT, lit
from openvox.view.viewpoint import from_above

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
Picture = NDArray[np.uint8]


def read(path: Path) -> Picture:
    picture = cv2.imread(str(path))
    assert picture is not None
    return np.asarray(picture[..., ::-1], np.uint8)


def hue(color: tuple[int, ...]) -> NDArray[np.float64]:
    """A colour without its brightness, which light changes."""
    return np.array(color) / max(color)


def pixels_of(picture: Picture, instance: int) -> int:
    """Pixels in an instance's colour, however lit."""
    bright = picture.max(-1)
    close = np.abs(picture / np.maximum(bright, 1)[..., None] - hue(instance_color(instance))).max(-1) < 0.03
    return int((close & (bright > 60)).sum())


def room(*, ceiling: bool) -> dict[tuple[int, int, int], int]:
    """Four walls and a floor around instances 1 to 4, a block near each corner; 80 cm high at 10 cm."""
    cells = {}
    for x in range(20):
        for y in range(16):
            for z in range(8):
                if x in (0, 19) or y in (0, 15) or z == 0 or (ceiling and z == 7):
                    cells[x, y, z] = 0
                if x % 10 in (4, 5, 6) and y % 8 in (3, 4, 5) and 0 < z < 4:
                    cells[x, y, z] = 1 + x // 10 + 2 * (y // 8)
    return cells


def drawn(cells: dict[tuple[int, int, int], int], out: Path) -> Picture:
    index, label = np.array(list(cells), np.int32), np.array(list(cells.values()), np.int32)
    draw_map(labelled_map(index, label, voxel_size=0.1), out, width=320, height=200)
    return read(out)


def test_the_map_is_a_picture_of_the_asked_size_and_nothing_else_is_left(tmp_path: Path) -> None:
    picture = drawn(room(ceiling=False), tmp_path / "map.png")
    assert picture.shape == (200, 320, 3)
    assert tuple(picture[0, 0]) == PAPER
    assert [file.name for file in tmp_path.iterdir()] == ["map.png"]


def test_ceiling_and_near_walls_hide_nothing(tmp_path: Path) -> None:
    seen = []
    for ceiling in (False, True):
        picture = drawn(room(ceiling=ceiling), tmp_path / "map.png")
        seen.append(min(pixels_of(picture, instance) for instance in (1, 2, 3, 4)))
    assert seen[0] > 100
    assert seen[1] >= seen[0]  # even larger, as the walls are cut below the ceiling


def test_an_empty_map_is_an_empty_picture(tmp_path: Path) -> None:
    empty = labelled_map(np.zeros((0, 3), np.int32), np.zeros(0, np.int32))
    draw_map(empty, tmp_path / "map.png", width=64, height=40)
    assert (read(tmp_path / "map.png") == PAPER).all()


def test_large_ids_cost_no_memory(tmp_path: Path) -> None:
    cells = {cell: 2**31 - 2 if label else 0 for cell, label in room(ceiling=False).items()}
    assert pixels_of(drawn(cells, tmp_path / "map.png"), 2**31 - 2) > 100


def test_a_picture_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"missing/map\.png could not be written"):
        draw_map(small_map(), tmp_path / "missing" / "map.png", width=64, height=40)


# ---- a frame ---------------------------------------------------------------------------------------------------------


def decision(mask: int, fragment: int) -> Decision:
    return Decision(mask, "threshold", fragment, fragment, (fragment,), 9, 0, 0, 0, 0, 0, 0, 0, ())


def square(x: int, y: int, side: int, caption: str = "") -> Mask:
    bitmap = np.zeros((480, 640), np.bool_)
    bitmap[y : y + side, x : x + side] = True
    return Mask.from_bitmap(bitmap, caption=caption)


def test_a_frame_shows_masks_in_the_colours_of_the_finished_map_beside_it(tmp_path: Path) -> None:
    """Fragment 7 became part of instance 5; fragment 9 is no part of the map."""
    camera = Intrinsics(640, 480, 500.0, 500.0, 319.5, 239.5)
    (frame,) = tiny_frames(1, camera=camera, color_format="")
    result = replace(
        small_map(), voxel_index=np.array([[-4, -2, 12], [-1, -2, 12], [0, -2, 12], [3, -2, 12]], np.int32)
    )
    masks = (square(60, 60, 90), square(400, 300, 90), square(10, 400, 40))
    decisions = (decision(0, 7), decision(1, 2), decision(2, 9))
    out = tmp_path / "frame.png"
    draw_frame(replace(frame, world_from_depth=Pose.identity()), masks, decisions, result, out)
    picture = read(out)
    assert picture.shape == (480 + TITLE + MARGIN, 2 * 640 + 3 * MARGIN, 3)
    left, right = (picture[TITLE : TITLE + 480, x : x + 640] for x in (MARGIN, 2 * MARGIN + 640))
    for (x, y), color in {
        (65, 65): instance_color(5),
        (405, 305): instance_color(2),
        (13, 403): UNASSIGNED,
        (300, 100): (90, 90, 90),
    }.items():
        mixed = (np.array(color) + 90) // 2
        assert left[y, x] == pytest.approx(mixed, abs=2), (x, y)
    assert pixels_of(right, 5) > 1000  # one voxel of 4 cm, half a metre away
    assert pixels_of(right, 2) > 2 * 1000
    assert pixels_of(right, 7) == 0
    assert [file.name for file in tmp_path.iterdir()] == ["frame.png"]


def test_a_frame_with_colour_is_shown_as_it_is_where_no_mask_lies(tmp_path: Path) -> None:
    (frame,) = tiny_frames(1, color_format="png")
    draw_frame(frame, (), (), small_map(), tmp_path / "frame.png")
    shown = read(tmp_path / "frame.png")[TITLE : TITLE + 24, MARGIN : MARGIN + 32]
    stored = cv2.imdecode(np.frombuffer(frame.color, np.uint8), cv2.IMREAD_COLOR)
    assert stored is not None
    assert (shown == stored[..., ::-1]).all()


# ---- parts -----------------------------------------------------------------------------------------------------------


def test_a_cube_seen_from_straight_ahead_shows_the_face_towards_the_camera() -> None:
    """The camera looks along z, so it sees the lower face across z; colours at its rim are darker."""
    index = np.array([[0, 0, 5]], np.int32)
    pose = np.eye(4)
    rows = render_rows(index, 1.0, pose, CAMERA)
    colors = np.full((48, 64, 3), 200, np.uint8)
    picture = lit(colors, rows, index, rows, 1.0, pose, CAMERA)
    assert picture[26, 36].tolist() == [int(200 * LIGHT[2, 0])] * 3
    assert picture[10, 10].tolist() == [200] * 3
    last = int(np.flatnonzero(rows[26] == 0)[-1])
    assert picture[26, last].max() < int(200 * LIGHT[2, 0] * EDGE)


def test_the_overview_holds_every_point_and_wastes_no_room() -> None:
    points = np.random.default_rng(0).uniform((0, 0, 0), (5, 4, 2.5), (500, 3))
    for azimuth in (0.0, 1.0, 4.0):
        pose = from_above(points, CAMERA, azimuth)
        x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
        u, v = 60.0 * x / z / 64, 60.0 * y / z / 48
        assert z.min() > 0
        assert max(np.abs(u).max(), np.abs(v).max()) == pytest.approx(0.45, abs=0.005)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
        assert pose[2, 1] < 0  # the picture's down is down


def test_names_stay_in_the_picture_and_off_each_other() -> None:
    notes = [Note(f"thing {i}", (5 + i, 50)) for i in range(6)]
    placed = place((100, 200, 3), notes, 0.45)
    boxes = [box for _, box in placed]
    assert [note.text for note, _ in placed][:3] == ["thing 0", "thing 1", "thing 2"]
    assert all(b[0] >= 0 and b[1] >= 0 and b[2] <= 200 and b[3] <= 100 for b in boxes)
    for i, a in enumerate(boxes):
        assert all(a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1] for b in boxes[:i])
    assert place((20, 30, 3), [Note("far too long for this", (5, 5))], 0.45) == []


def test_letters_are_light_on_a_dark_halo_on_any_ground() -> None:
    for ground in (0, 128, 255):
        image = np.full((40, 160, 3), ground, np.uint8)
        annotate(image, [Note("chair", (80, 20))])
        assert image.max() > 200
        assert image.min() < 60


def test_the_smallest_mask_lies_on_top() -> None:
    masks = (square(0, 0, 10), square(0, 0, 300), square(5, 5, 10))
    image = mask_image(masks, 480, 640)
    assert (image[2, 2], image[7, 7], image[12, 12], image[100, 100], image[400, 400]) == (0, 0, 2, 1, -1)


def test_a_long_caption_is_cut_and_stays_on_its_line() -> None:
    assert shortened("a  chair\nby the window", 30) == "a chair by the window"
    assert shortened("a chair by the window", 9) == "a chair…"
    assert Captions().of(3) == ""
