"""The front end that comes with openvox: exact coordinates, things parted and joined, words where sure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from worlds import Box as Solid
from worlds import encode_color, look_at, render, tiny_frames

from openvox.apps.perceive import perceive
from openvox.core.types import Frame, Intrinsics, Mask, Pose, Rig
from openvox.formats.detections import Box
from openvox.formats.perception import read_masks
from openvox.perception.bodies import bodies_of
from openvox.perception.claims import claims
from openvox.perception.det.boxes import Letterbox, letterboxed, suppressed
from openvox.perception.joined import joined
from openvox.perception.namer import GREY, SIDE, Namer, square
from openvox.perception.nanodet import NanoDet
from openvox.perception.offline import EVERYDAY, Offline, Words, captioned, colors_of, guesses, mask_score
from openvox.perception.parameters import GeometryParameters, OfflineParameters
from openvox.perception.parts import Parts, parted
from openvox.perception.planes import Plane, Room
from openvox.perception.regions import depth_at_color_pixels
from openvox.perception.segments import background_of, segments
from openvox.perception.sizes import SIZE_OF, SIZES, extent_of, fits
from openvox.perception.supports import FLOOR as ON_FLOOR
from openvox.perception.surface import surface
from openvox.perception.trim import trim
from openvox.perception.wording import Form

CAMERA = Intrinsics(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)
GEOMETRY = GeometryParameters(plane_area=0.3)
OFFLINE = OfflineParameters()
FLOOR = Room((0.0, 0.0, 1.0), (Plane((0.0, 0.0, 1.0), 0.0),))
TABLE = Solid(1, 7, (-0.8, 1.6, 0.0), (0.8, 2.6, 0.75), (120, 80, 40))


def photograph(*solids: Solid, eye: tuple[float, float, float] = (0.0, 0.4, 1.7)) -> Frame:
    pose = look_at(eye, (0.0, 2.0, 0.8))
    depth, ids, _, color = render(pose, CAMERA, solids)
    rig = Rig(CAMERA, CAMERA)
    return Frame(0, 0, pose, rig, depth, encode_color(color, "png"), "png", truth_instances=ids)


def parts_of(frame: Frame, offline: OfflineParameters = OFFLINE) -> Parts:
    from openvox.formats.images import decode_color

    return parted(frame, decode_color(frame), FLOOR, GEOMETRY, offline)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def best(parts: Parts, truth: np.ndarray) -> tuple[float, int]:
    """Best IoU of a region with it, and the region."""
    return max((overlap(parts.labels == i, truth), i) for i in range(1, len(parts.depths)))


# Boxes


@pytest.mark.parametrize(("width", "height"), [(640, 480), (480, 640), (416, 416), (1001, 333)])
def test_a_point_of_the_picture_is_found_again_after_the_letterbox(width, height):
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[height // 2 :, width // 2 :] = 255
    square_, place = letterboxed(rgb, 416, 416)
    assert square_.shape == (1, 3, 416, 416)
    row = np.flatnonzero(square_[0, 0, :, 415 - place.left] > 0.5)[0]
    column = np.flatnonzero(square_[0, 0, 415 - place.top, :] > 0.5)[0]
    ((x, y, _, _),) = place.undone(np.array([[column, row, 416, 416]], np.float32), width, height)
    assert abs(x - width // 2) <= 1 / place.scale_x
    assert abs(y - height // 2) <= 1 / place.scale_y


def test_the_letterbox_is_undone_by_moving_first_and_scaling_then_and_boxes_end_at_the_rim():
    place = Letterbox(scale_x=0.65, scale_y=0.65, left=0, top=52)
    found = place.undone(np.array([[65.0, 117.0, 130.0, 182.0], [-9.0, 0.0, 500.0, 416.0]], np.float32), 640, 480)
    np.testing.assert_allclose(found, [[100, 100, 200, 200], [0, 0, 640, 480]], rtol=1e-6)


def test_red_comes_first_and_one_is_the_brightest():
    picture, place = letterboxed(np.full((10, 20, 3), (255, 51, 0), np.uint8), 40, 40)
    np.testing.assert_allclose(picture[0, :, 20, 20], (1, 0.2, 0), atol=1e-6)
    assert (picture[0, :, : place.top] == 0).all()


def test_of_two_boxes_on_one_thing_the_better_stays_and_other_kinds_may_overlap_more():
    corners = np.array([[0, 0, 10, 10], [0, 0, 10, 9], [0, 0, 10, 7], [50, 0, 60, 10]], np.float32)
    scores = np.array([0.8, 0.9, 0.7, 0.8], np.float32)
    assert suppressed(corners, scores, np.array([1, 1, 1, 1])) == [1, 3]
    assert suppressed(corners, scores, np.array([1, 1, 2, 1])) == [1, 3, 2]
    assert suppressed(corners[:0], scores[:0], np.array([], np.int64)) == []


def test_a_plain_picture_holds_nothing_and_a_frame_without_colour_neither():
    detector = NanoDet(OFFLINE)
    frame = tiny_frames(1, camera=CAMERA)[0]
    grey = replace(frame, color=encode_color(np.full((240, 320, 3), 127, np.uint8), "png"), color_format="png")
    assert detector(grey) == ()
    assert detector(replace(frame, color=b"", color_format="")) == ()


# Parts


def test_what_stands_on_a_table_and_is_one_surface_with_it_is_parted_by_height():
    low = Solid(2, 29, (-0.2, 1.9, 0.75), (0.2, 2.2, 0.81), (250, 250, 250))
    frame = photograph(TABLE, low)
    whole = parts_of(frame, replace(OFFLINE, support_height=1.0, patch_ground=1_000_000))
    split = parts_of(frame, replace(OFFLINE, patch_ground=1_000_000))
    truth = frame.truth_instances == 2
    assert best(split, truth)[0] > 0.6
    assert best(split, truth)[0] >= best(whole, truth)[0]


def test_a_picture_on_a_wall_is_parted_by_colour_and_counts_as_split_off():
    wall = Solid(1, 1, (-5.0, 2.5, 0.0), (5.0, 3.0, 3.0), (200, 200, 190))
    picture = Solid(2, 29, (-0.4, 2.49, 0.6), (0.4, 2.5, 1.2), (180, 40, 40))
    frame = photograph(wall, picture)
    room = Room((0.0, 0.0, 1.0), (*FLOOR.planes, Plane((0.0, -1.0, 0.0), -2.5)))
    masks = Offline(GEOMETRY, OFFLINE, room)(frame, ())
    (mask,) = (mask for mask in masks if overlap(mask.bitmap(240, 320), frame.truth_instances == 2) > 0.8)
    assert mask.kind == "support"
    assert mask.caption == "a red vertical surface on the wall"


def test_arms_of_a_seat_do_not_stand_on_it():
    seat = Solid(1, 7, (-0.6, 1.8, 0.0), (0.6, 2.6, 0.4), (120, 80, 40))
    arms = [Solid(1, 7, (x, 1.8, 0.4), (x + 0.15, 2.6, 0.5), (120, 80, 40)) for x in (-0.75, 0.6)]
    whole = replace(GEOMETRY, crease=-1.0, merge_smooth=0.1)  # nothing but height could part them
    frame = photograph(seat, *arms)
    from openvox.formats.images import decode_color

    for within, standing in ((0.8, False), (0.0, True)):
        offline = replace(OFFLINE, support_within=within, patch_ground=1_000_000)
        parts = parted(frame, decode_color(frame), FLOOR, whole, offline)
        assert (len(parts.depths) - 1 > parts.pieces) is standing


def test_what_stands_on_a_segment_or_by_itself_on_the_floor_is_known():
    box = Solid(2, 29, (-0.3, 1.9, 0.75), (0.0, 2.2, 1.1), (250, 250, 250))
    beside = Solid(3, 29, (0.2, 1.9, 0.0), (0.5, 2.2, 0.9), (20, 200, 20))
    frame = photograph(replace(TABLE, high=(0.1, 2.6, 0.75)), box, beside)
    parts = parts_of(frame)
    table, upper, lower = (best(parts, frame.truth_instances == i)[1] for i in (1, 2, 3))
    assert parts.on == {upper: table, lower: ON_FLOOR}
    kinds = {
        i: mask.kind
        for mask in Offline(GEOMETRY, OFFLINE, FLOOR)(frame, ())
        for i in (1, 2, 3)
        if overlap(mask.bitmap(240, 320), frame.truth_instances == i) > 0.7
    }
    assert kinds == {1: "region", 2: "support", 3: "support"}


SPEAKER = Solid(3, 29, (0.3, 1.8, 0.0), (0.6, 2.1, 0.8), (20, 20, 20))


@pytest.mark.parametrize(
    ("solids", "free"),
    [
        ((SPEAKER,), True),
        ((SPEAKER, replace(TABLE, high=(0.25, 2.6, 0.75))), True),  # beside a table
        ((replace(SPEAKER, low=(0.3, 1.8, 0.3)),), False),  # in the air
        ((replace(SPEAKER, high=(0.6, 2.1, 0.1)),), False),  # a foot
        ((SPEAKER, Solid(4, 7, (0.1, 1.6, 0.95), (0.8, 2.4, 1.0), (120, 80, 40))), False),  # a leg of what is above
        ((replace(SPEAKER, high=(3.0, 2.1, 0.8)),), False),  # cut off by the picture's edge
    ],
)
def test_what_reaches_the_floor_and_ends_in_an_open_top_stands_there_by_itself(solids, free):
    frame = photograph(*solids)
    parts = parts_of(frame)
    assert (parts.on.get(best(parts, frame.truth_instances == 3)[1]) == ON_FLOOR) is free


POT = Solid(2, 7, (-0.1, 1.9, 0.0), (0.1, 2.1, 0.4), (120, 80, 40))
CROWN = Solid(2, 7, (-0.5, 1.8, 0.4), (0.5, 2.2, 1.0), (20, 160, 20))
BESIDE = Solid(3, 7, (0.55, 1.9, 0.0), (0.75, 2.1, 0.4), (120, 80, 40))


def joins(*solids: Solid) -> int:
    """How many segments of a photograph become parts of others."""
    frame = photograph(*solids, eye=(0.0, 0.3, 0.6))
    seen = surface(frame.depth, CAMERA, GEOMETRY.near, GEOMETRY.far)
    pose = frame.world_from_depth
    labels, pieces = segments(seen, background_of(seen, FLOOR, pose), GEOMETRY)
    return int(labels.max() - joined(labels, pieces, seen, FLOOR, pose, GEOMETRY).max())


@pytest.mark.parametrize(
    ("solids", "number"),
    [
        ((POT, CROWN), 1),
        ((POT, CROWN, BESIDE), 1),
        ((BESIDE, CROWN), 0),  # not under it
        ((replace(POT, high=(0.1, 2.1, 0.2)), CROWN), 0),  # does not touch it
    ],
)
def test_what_a_narrow_thing_bears_is_one_with_it(solids, number):
    assert joins(*solids) == number


def test_a_left_over_too_small_for_a_region_stays_only_as_a_pole_of_what_it_bears():
    shade = Solid(1, 7, (-0.25, 1.9, 0.7), (0.25, 2.3, 1.1), (250, 240, 200))
    pole = Solid(2, 7, (-0.02, 2.09, 0.3), (0.02, 2.11, 0.7), (250, 240, 200))
    alone = Solid(3, 7, (0.58, 2.09, 0.3), (0.62, 2.11, 0.7), (250, 240, 200))
    strip = Solid(4, 7, (-0.2, 2.2, 0.64), (0.2, 2.22, 0.7), (250, 240, 200))  # under the shade, but no pole
    frame = photograph(shade, pole, alone, strip, eye=(0.0, 0.3, 0.3))
    truth = frame.truth_instances.astype(np.int32)
    seen = surface(frame.depth, CAMERA, GEOMETRY.near, GEOMETRY.far)
    out = joined(truth, 1, seen, FLOOR, frame.world_from_depth, GEOMETRY)  # 2 to 4 are left-overs
    assert np.array_equal(out, np.where(truth <= 2, truth > 0, 0))


ROOM = Room((0.0, 0.0, 1.0), (*FLOOR.planes, Plane((0.0, -1.0, 0.0), -2.6)))
"""With a wall at y = 2.6."""
WALL = Solid(9, 1, (-4.0, 2.6, 0.0), (4.0, 2.8, 3.0), (200, 200, 200))


@pytest.mark.parametrize(
    ("solids", "is_trim"),
    [
        ([((-0.7, 2.5, 0.8), (0.7, 2.6, 0.9))], True),  # a sill
        ([((-0.7, 2.56, z), (0.7, 2.6, z + 0.08)) for z in (0.6, 1.4)]
         + [((x, 2.56, 0.6), (x + 0.08, 2.6, 1.48)) for x in (-0.7, 0.62)], True),  # a frame
        ([((-0.7, 2.3, 0.8), (0.7, 2.6, 0.83))], False),  # a shelf
        ([((-1.3, 2.5, 0.9), (1.3, 2.6, 1.25))], False),  # a radiator
        ([((-0.1, 2.52, 0.8), (0.1, 2.6, 0.95))], False),  # a clock
        ([((-0.7, 1.9, 0.8), (0.7, 2.0, 0.9))], False),  # not at the wall
        ([((-0.7, 2.44, 0.8), (0.7, 2.47, 0.9))], False),  # before it, as a rail that is nowhere at the wall
        ([((-0.7, 2.45, 1.5), (0.7, 2.6, 2.4))], False),  # a cupboard of which the picture shows the lowest part
    ],
)  # fmt: skip
def test_sills_and_frames_are_part_of_the_room(solids, is_trim):
    frame = photograph(WALL, *(Solid(2, 9, low, high, (250, 250, 250)) for low, high in solids), eye=(0.0, 0.4, 1.2))
    seen = surface(frame.depth, CAMERA, GEOMETRY.near, GEOMETRY.far)
    thing = (frame.truth_instances == 2).astype(np.int32)[:: seen.step, :: seen.step]
    bodies = bodies_of(thing, seen, ROOM, frame.world_from_depth, GEOMETRY)
    assert trim(bodies, thing, ROOM, 60) == [1] * is_trim
    assert trim(bodies, thing, FLOOR, 60) == trim(bodies, thing, ROOM, len(bodies[0].height) + 1) == []
    behind = Room(ROOM.up, (*FLOOR.planes, Plane((0.0, -1.0, 0.0), -1.6)))
    assert trim(bodies, thing, behind, 60) == []  # what is behind a wall is none of its trim
    covered = [overlap(mask.bitmap(240, 320), frame.truth_instances == 2) for mask in masks_in(ROOM, frame)]
    assert (max(covered, default=0) > 0.5) is not is_trim


def masks_in(room: Room, frame: Frame) -> tuple[Mask, ...]:
    return Offline(GEOMETRY, OFFLINE, room)(frame, ())


def test_a_narrow_thing_on_furniture_at_the_wall_is_no_trim():
    sideboard = Solid(1, 7, (-0.8, 2.1, 0.0), (0.8, 2.6, 0.75), (120, 80, 40))
    bottle = Solid(2, 7, (0.0, 2.48, 0.75), (0.08, 2.56, 1.05), (20, 120, 20))
    frame = photograph(WALL, sideboard, bottle, eye=(0.0, 0.4, 1.2))
    covered = [overlap(mask.bitmap(240, 320), frame.truth_instances == 2) for mask in masks_in(ROOM, frame)]
    assert max(covered) > 0.7


def test_a_poster_beside_a_sill_is_still_a_thing_on_the_wall():
    sill = Solid(2, 9, (-0.7, 2.5, 0.6), (0.7, 2.6, 0.7), (250, 250, 250))
    poster = Solid(3, 11, (-0.3, 2.597, 0.9), (0.3, 2.6, 1.3), (20, 60, 200))
    frame = photograph(WALL, sill, poster, eye=(0.0, 0.4, 1.2))
    found = {mask.kind: overlap(mask.bitmap(240, 320), frame.truth_instances == 3) for mask in masks_in(ROOM, frame)}
    assert found["support"] > 0.7


def bookcase(width: float, depth: float = 0.3, upper_depth: float = 0.3) -> list[Solid]:
    """Two boards with a row of books on each."""
    x, back = width / 2, 2.0 + depth
    out = []
    for z, near in ((0.0, 2.0), (0.4, back - upper_depth)):
        out.append(Solid(2, 10, (-x, near, z), (x, back, z + 0.03), (120, 80, 40)))
        out.append(Solid(2, 10, (-x, near + 0.06, z), (x, back, z + 0.25), (120, 80, 40)))
    return out


def test_storeys_of_furniture_are_one_thing():
    frame = photograph(*bookcase(0.9), eye=(0.0, 0.3, 0.9))
    assert best(parts_of(frame), frame.truth_instances == 2)[0] > 0.8


def test_a_narrow_pile_and_a_board_above_half_of_another_one_are_no_storeys():
    narrow = photograph(*bookcase(0.4), eye=(0.0, 0.3, 0.9))
    assert best(parts_of(narrow), narrow.truth_instances == 2)[0] < 0.8
    stepped = photograph(*bookcase(0.9, depth=0.6, upper_depth=0.15), eye=(0.0, 0.3, 0.9))
    assert best(parts_of(stepped), stepped.truth_instances == 2)[0] < 0.8


def test_a_sheet_on_an_even_table_is_parted_by_colour():
    sheet = Solid(2, 29, (-0.2, 1.9, 0.75), (0.2, 2.2, 0.752), (250, 250, 250))
    frame = photograph(TABLE, sheet)
    truth = frame.truth_instances == 2
    assert best(parts_of(frame), truth)[0] > 0.7
    assert best(parts_of(frame, replace(OFFLINE, patch_ground=1_000_000)), truth)[0] < 0.3


def test_a_checked_table_has_no_patches():
    squares = [
        Solid(2, 29, (x / 10 - 0.8, y / 10 + 1.6, 0.75), (x / 10 - 0.7, y / 10 + 1.7, 0.751), (250, 250, 250))
        for x in range(16)
        for y in range(10)
        if (x + y) % 2
    ]
    assert parts_of(photograph(TABLE, *squares)).depths.shape == (2,)  # the table


# Boxes and parts


def two_parts() -> Parts:
    """Region 1 and 2 side by side, one behind, region 3 far behind both."""
    labels = np.zeros((60, 80), np.int32)
    labels[20:40, 20:30], labels[20:40, 30:40], labels[10:20, 20:40] = 1, 2, 3
    z = np.choose(labels, [4.0, 1.0, 1.05, 3.0]).astype(np.float32)
    return Parts(labels, labels == 0, z, np.array([0, 1.0, 1.05, 3.0], np.float32), {}, 3)


def test_a_box_joins_the_regions_in_it_that_are_near_each_other():
    parts = two_parts()
    rgb = np.zeros((60, 80, 3), np.uint8)
    (thing,) = claims([Box((19, 9, 41, 41), 0.9, "chair")], parts, rgb, 100.0, OFFLINE)
    assert thing.regions == (1, 2)
    np.testing.assert_array_equal(thing.bitmap, (parts.labels == 1) | (parts.labels == 2))


def test_a_box_leaves_what_stands_on_the_thing_in_it_alone():
    parts = replace(two_parts(), on={2: 1})
    (thing,) = claims([Box((19, 9, 41, 41), 0.9, "chair")], parts, np.zeros((60, 80, 3), np.uint8), 100.0, OFFLINE)
    assert thing.regions == (1,)


@pytest.mark.parametrize(
    ("inner", "score", "outer", "found"),
    [
        ("potted plant", 0.5, "potted plant", ["potted plant"]),  # the pot, and all of it
        ("potted plant", 0.7, "potted plant", ["potted plant", "potted plant"]),  # the inner one is surer
        ("keyboard", 0.9, "laptop", ["laptop"]),
        ("cup", 0.4, "dining table", ["cup", "dining table"]),
    ],
)
def test_a_box_around_a_part_of_a_thing_gives_way_to_that_of_the_whole(inner, score, outer, found):
    boxes = [Box((19, 9, 41, 41), 0.6, outer), Box((29, 19, 41, 41), score, inner)]
    things = claims(boxes, two_parts(), np.zeros((60, 80, 3), np.uint8), 100.0, OFFLINE)
    assert [thing.box.label for thing in things if thing.box] == found


def test_a_small_box_takes_its_region_before_a_large_one():
    parts = two_parts()
    rgb = np.zeros((60, 80, 3), np.uint8)
    large, small = Box((19, 9, 41, 41), 0.9, "chair"), Box((29, 19, 41, 41), 0.4, "cup")
    things = claims([large, small], parts, rgb, 100.0, OFFLINE)
    assert [(thing.box.label, thing.regions) for thing in things if thing.box] == [("cup", (2,)), ("chair", (1,))]


def test_a_table_leaves_the_small_things_in_its_box_alone():
    labels = np.zeros((60, 80), np.int32)
    labels[20:50, 10:70] = 1
    labels[15:20, 30:36] = 2
    z = np.where(labels > 0, 1.0, 4.0).astype(np.float32)
    parts = Parts(labels, labels == 0, z, np.array([0, 1.0, 1.0], np.float32), {}, 2)
    rgb = np.zeros((60, 80, 3), np.uint8)
    for word, regions in (("dining table", (1,)), ("chair", (1, 2))):
        (thing,) = claims([Box((9, 14, 71, 51), 0.9, word)], parts, rgb, 100.0, OFFLINE)
        assert thing.regions == regions


def test_a_screen_without_depth_is_cut_out_by_colour():
    """A dark screen measures nothing, so no region is there; the wall behind is known not to be it."""
    rgb = np.full((120, 160, 3), 220, np.uint8)
    rgb[30:80, 40:110] = (20, 20, 30)
    screen = rgb[..., 0] < 100
    labels = np.zeros((120, 160), np.int32)
    z = np.where(screen, 0, 3.0).astype(np.float32)
    parts = Parts(labels, ~screen, z, np.zeros(1, np.float32), {}, 0)
    (thing,) = claims([Box((36, 27, 114, 84), 0.6, "tv")], parts, rgb, 100.0, OFFLINE)
    assert overlap(thing.bitmap, screen) > 0.9
    assert thing.regions == ()


def test_a_box_around_nothing_is_dropped():
    labels = np.zeros((120, 160), np.int32)
    z = np.full((120, 160), 3.0, np.float32)
    parts = Parts(labels, labels == 0, z, np.zeros(1, np.float32), {}, 0)
    rgb = np.full((120, 160, 3), 220, np.uint8)
    boxes = [Box((36, 27, 114, 84), 0.6, "tv"), Box((5, 5, 6, 6), 0.9, "cup"), Box((-9, 0, -3, 7), 0.9, "cup")]
    assert claims(boxes, parts, rgb, 100.0, OFFLINE) == []


# Words


def test_the_classifier_sees_the_mask_alone_in_the_middle_of_grey():
    rgb = np.full((100, 100, 3), (200, 0, 0), np.uint8)
    bitmap = np.zeros((100, 100), np.bool_)
    bitmap[0:40, 60:100] = True
    crop = square(rgb, Mask.from_bitmap(bitmap))
    assert crop.shape == (SIDE, SIDE, 3)
    assert crop[SIDE // 2, SIDE // 2].tolist() == [200, 0, 0]
    for row, column in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert crop[row, column].tolist() == [GREY] * 3


def test_no_masks_need_no_words():
    assert Namer()(np.zeros((10, 10, 3), np.uint8), []) == []


def test_probabilities_of_classes_that_share_a_noun_are_summed():
    namer = Namer()
    logits = np.full((1, 1000), -20.0, np.float32)
    logits[0, [504, 967, 968]] = 5.0  # a mug, and two classes that are cups
    (row,) = namer._nouns(logits)
    assert row[namer.nouns.index("cup")] == pytest.approx(2 / 3, abs=1e-6)
    assert row[namer.nouns.index("mug")] == pytest.approx(1 / 3, abs=1e-6)


SEAT = Solid(1, 7, (-0.2, 1.8, 0.0), (0.2, 2.2, 0.9), (250, 250, 250))


def words_of(monkeypatch: pytest.MonkeyPatch, box: Box | None, *nouns: tuple[str, float]) -> Mask:
    """The mask of a frame with one thing in it, where detector and classifier say what they are told to."""
    monkeypatch.setattr(Namer, "__call__", lambda self, rgb, masks: [list(nouns)] * len(masks))
    stage = Offline(GEOMETRY, OFFLINE, FLOOR)
    (mask,) = stage(photograph(SEAT), () if box is None else (box,))
    return mask


def box_of(score: float, label: str = "chair", wider: float = 0.0) -> Box:
    rows, columns = np.nonzero(photograph(SEAT).truth_instances == 1)
    x0, y0, x1, y1 = columns.min() - wider, rows.min(), columns.max() + 1 + wider, rows.max() + 1
    return Box((float(x0), float(y0), float(x1), float(y1)), score, label)


@pytest.mark.parametrize(
    ("box", "noun", "caption", "score", "kind"),
    [
        (box_of(0.8), ("lamp", 0.9), "a white chair", 0.8, "object"),  # a sure detector is believed
        (box_of(0.45), ("lamp", 0.9), "a white lamp", 0.9, "object"),  # else the classifier
        (box_of(0.45), ("lamp", 0.2), "a white chair", 0.45, "object"),  # else a likely detector
        (box_of(0.35), ("lamp", 0.2), "", 0.5, "object"),  # else nobody
        (None, ("lamp", 0.36), "a white lamp", 0.36, "support"),
        (None, ("lamp", 0.34), "", 0.5, "support"),
        (box_of(0.8, "cup"), ("lamp", 0.9), "a white lamp", 0.9, "region"),  # no cup is 90 cm high
        (box_of(0.8, "cup"), ("mug", 0.9), "", 0.5, "region"),
    ],
)
def test_words_are_given_only_where_they_are_mostly_right(monkeypatch, box, noun, caption, score, kind):
    mask = words_of(monkeypatch, box, noun)
    assert mask.named is bool(caption)
    assert mask.caption == caption or (not caption and mask.caption.startswith("a white "))
    assert mask.caption_score == pytest.approx(score)
    assert mask.kind == kind


def test_a_box_that_is_not_the_masks_gives_no_word(monkeypatch):
    assert not words_of(monkeypatch, box_of(0.9, wider=60.0), ("lamp", 0.1)).named


def test_what_else_a_thing_may_be_is_kept_at_half_its_probability(monkeypatch):
    nouns = (("mug", 0.3), ("lamp", 0.2), ("chair", 0.1))
    assert words_of(monkeypatch, None, *nouns).alternatives == (
        ("lamp", "a white lamp", 0.1),
        ("chair", "a white chair", 0.05),
    )
    assert words_of(monkeypatch, box_of(0.45), *nouns).alternatives == (("lamp", "a white lamp", 0.1),)
    assert words_of(monkeypatch, box_of(0.8), *nouns).alternatives == ()  # the classifier is not asked


def test_what_stands_upright_and_has_no_word_may_be_a_picture_or_a_cabinet():
    picture, front = Form("", "vertical surface", "on the wall"), Form("large", "vertical surface", "on the floor")
    assert list(guesses(picture, "support", 0.5)) == ["picture"]
    assert list(guesses(picture, "region", 0.5)) == []  # no patch that differs from its wall
    assert list(guesses(picture, "support", 2.0)) == list(guesses(picture, "support", 0.0)) == []
    assert list(guesses(front, "region", 1.5)) == ["cabinet"]
    assert list(guesses(replace(front, size=""), "region", 1.0)) == []
    assert list(guesses(replace(front, thing="object"), "region", 1.5)) == []


def test_what_was_put_down_and_has_no_word_may_be_a_box():
    put_down = Form("", "object", "on a low surface")
    assert list(guesses(put_down, "support", 0.3)) == ["box"]
    assert list(guesses(put_down, "region", 1.0)) == list(guesses(put_down, "region", 0.05)) == []
    assert list(guesses(replace(put_down, place="on the wall"), "region", 0.3)) == []
    assert list(guesses(replace(put_down, place=""), "region", 0.3)) == []  # nothing is seen under it


def test_a_guess_is_an_alternative_of_a_mask_without_a_word():
    mask, form = Mask.from_bitmap(np.ones((4, 4), np.bool_)), Form("", "vertical surface", "on the wall")
    unnamed = captioned(mask, "support", form, 0.5, Words(), "red")
    assert unnamed.alternatives == (("picture", "a red picture", 0.1),)
    assert not unnamed.named
    assert captioned(mask, "support", form, 0.5, Words(("clock", 0.8)), "red").alternatives == ()


def test_a_thing_has_one_word_whichever_model_gives_it(monkeypatch):
    mask = words_of(monkeypatch, box_of(0.8, "couch"))
    assert (mask.label, mask.caption) == ("sofa", "a white sofa")
    nouns = set(Namer().nouns)
    assert set(EVERYDAY.values()) <= nouns
    assert not set(EVERYDAY) & nouns


def test_the_size_of_a_mask_is_the_largest_extent_of_what_depth_shows():
    frame = photograph(SEAT)
    z, camera = depth_at_color_pixels(frame.depth, frame.rig), frame.rig.color
    mask = Mask.from_bitmap(frame.truth_instances == 1)
    assert extent_of(mask, z, camera) == pytest.approx(0.9, abs=0.1)
    assert extent_of(mask, np.zeros_like(z), camera) == 0.0  # not known


@pytest.mark.parametrize(
    ("noun", "extent", "may_be"),
    [
        ("baby bed", 0.2, False),
        ("baby bed", 1.2, True),
        ("cup", 0.9, False),
        ("cup", 0.0, True),
        ("unheard of", 9, True),
    ],
)
def test_a_noun_must_fit_the_size(noun, extent, may_be):
    assert fits(noun, extent) is may_be


def test_every_noun_of_the_models_has_one_size():
    detector = NanoDet(OFFLINE)
    words = [word for word, indoors in zip(detector._words, detector._indoors, strict=True) if indoors]
    assert {noun for noun in (*Namer().nouns, *words) if noun not in SIZE_OF} == set()
    assert len(SIZE_OF) == sum(len(nouns.split(",")) for nouns in SIZES)


def test_colours_are_those_of_the_mask_without_its_rim():
    rgb = np.full((60, 80, 3), 250, np.uint8)
    rgb[11:31, 21:41] = (200, 30, 30)
    bitmap = np.zeros((60, 80), np.bool_)
    bitmap[11:31, 21:41] = True
    bitmap[40:43, 0:3] = True
    assert colors_of(rgb, [Mask.from_bitmap(bitmap)]) == ["red"]
    thin = np.zeros((60, 80), np.bool_)
    thin[5, 5:9] = True
    assert colors_of(rgb, [Mask.from_bitmap(thin)]) == [""]


# The whole


def test_every_thing_of_a_small_room_has_a_mask():
    frames = tiny_frames(2, camera=CAMERA)
    detector, stage = NanoDet(OFFLINE), Offline(GEOMETRY, OFFLINE, FLOOR)
    for frame in frames:
        masks = stage(frame, detector(frame))
        for number in np.unique(frame.truth_instances[frame.truth_instances > 0]).tolist():
            truth = frame.truth_instances == number
            assert max(overlap(mask.bitmap(240, 320), truth) for mask in masks) > 0.8


def test_without_colour_regions_stay_without_words():
    frame = replace(tiny_frames(1, camera=CAMERA)[0], color=b"", color_format="")
    masks = Offline(GEOMETRY, OFFLINE, FLOOR)(frame, ())
    assert len(masks) >= 3
    assert not any(mask.named for mask in masks)
    assert masks[0].caption.startswith(("an object", "a vertical surface", "a horizontal surface"))


def test_masks_come_out_in_the_pixels_of_a_colour_camera_of_its_own():
    shifted = Pose((0.0, 0.0, 0.0, 1.0), (0.06, 0.01, 0.0))
    camera = Intrinsics(width=400, height=300, fx=300.0, fy=300.0, cx=190.0, cy=155.0)
    sheet = Solid(2, 29, (-0.2, 1.9, 0.75), (0.2, 2.2, 0.752), (250, 250, 250))
    pose = look_at((0.0, 0.4, 1.7), (0.0, 2.0, 0.8))
    depth, _, _, _ = render(pose, CAMERA, (TABLE, sheet))
    _, ids, _, color = render(Pose.from_matrix(pose.matrix() @ shifted.matrix()), camera, (TABLE, sheet))
    frame = Frame(0, 0, pose, Rig(CAMERA, camera, shifted), depth, encode_color(color, "png"), "png")
    assert best(parts_of(frame), ids == 2)[0] > 0.6


def test_the_number_of_workers_changes_no_byte(tmp_path: Path):
    from test_perceive import record

    path = record(tmp_path / "room.mcap", tiny_frames(3, camera=replace(CAMERA, width=160, height=120)))
    files = [perceive(path, jobs=jobs, out=tmp_path / f"{jobs}.mcap").output for jobs in (1, 3)]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert [found.index for found in read_masks(files[0])] == [0, 1, 2]


@pytest.mark.parametrize(
    ("box", "kind", "named", "score"),
    [
        ((10, 10, 60, 50), "object", False, 0.6),  # a detector's
        ((10, 10, 60, 50), "support", False, 0.5),
        ((10, 10, 30, 20), "region", False, 0.3),  # 200 pixels
        ((10, 10, 30, 20), "region", True, 0.5),
        ((10, 10, 60, 50), "region", False, 0.5),  # 2000 pixels
        ((0, 10, 20, 50), "region", False, 0.2),  # 800 pixels at the picture's edge
        ((300, 10, 320, 50), "region", False, 0.2),
        ((300, 10, 319, 50), "region", False, 0.5),
        ((0, 0, 60, 50), "region", False, 0.5),
    ],
)
def test_a_mask_is_as_sure_as_it_is_likely_a_whole_thing(box, kind, named, score):
    x0, y0, x1, y1 = box
    bitmap = np.zeros((240, 320), np.bool_)
    bitmap[y0:y1, x0:x1] = True
    assert mask_score(Mask.from_bitmap(bitmap), kind, named, CAMERA, OFFLINE) == score
