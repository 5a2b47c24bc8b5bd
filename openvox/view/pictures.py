"""Pictures of the map and of a frame, drawn without a screen."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from openvox.core.colors import instance_color
from openvox.core.types import Decision, Frame, InstanceMap, Intrinsics, Mask
from openvox.formats.atomic import partial_file
from openvox.formats.images import decode_color
from openvox.view.labels import UNASSIGNED, mask_image, shortened
from openvox.view.lettering import HALO, Note, annotate, write
from openvox.view.render import NOTHING, render_rows, take_rows
from openvox.view.shading import lit
from openvox.view.viewpoint import ELEVATION, best_azimuth, centres, from_above, narrow_camera, world_from_color

Picture = NDArray[np.uint8]
"""(height, width, 3), RGB."""
ColorOf = Callable[[int], tuple[int, int, int]]
PAPER = (250, 250, 248)
STRUCTURE = (222, 221, 217)
"""Voxels of no instance: walls and floor, and what was not detected."""
NOTES = 12
FLOOR_METRES = 0.15
"""Background up to here above the floor stays on the near side, where walls would hide the room."""
CEILING_METRES = 0.3
NO_CEILING = 2**31
LEAST_AREA = 0.001
"""Share of the picture that an instance must fill to be named in it."""
MARGIN = 12
TITLE = 34


def draw_map(result: InstanceMap, out: Path, *, width: int = 1280, height: int = 800) -> None:
    """A PNG of the whole map from above, ceiling and near walls cut away, the largest instances named.

    Raises OutputError where the file cannot be written.
    """
    write_png(out, map_picture(result, map_azimuth(result), width=width, height=height))


def map_azimuth(result: InstanceMap, wanted: Sequence[int] = ()) -> float:
    """The side, in radians from the x axis, from which a picture of the map shows most, of these instances if any."""
    return best_azimuth(result, _cutaway, wanted)


def map_picture(
    result: InstanceMap,
    azimuth: float,
    *,
    width: int,
    height: int,
    elevation: float = ELEVATION,
    color_of: ColorOf = instance_color,
    names: Mapping[int, str] | None = None,
) -> Picture:
    """The map from above, ceiling and near walls cut away, the largest instances named.

    azimuth, elevation: where the camera stands, radians from the x axis and from the level. color_of: an instance.
    names: of the instances that are named instead, however small they look.
    """
    camera = narrow_camera(2 * width, 2 * height)
    kept = _cutaway(result, azimuth)
    index, instances = result.voxel_index[kept], result.voxel_instance[kept]
    pose = from_above(centres(index, result.voxel_size), camera, azimuth, elevation)
    picture, labels = _view(index, instances, result.voxel_size, pose, camera, PAPER, color_of)
    picture = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    labels = labels[::2, ::2]
    if names is None:
        annotate(picture, _notes(labels, _captions(result)), scale=0.5)
    else:
        annotate(picture, _notes(np.where(np.isin(labels, list(names)), labels, 0), names, least=0), scale=0.5)
    return picture


def draw_frame(
    frame: Frame, masks: Sequence[Mask], decisions: Sequence[Decision], result: InstanceMap, out: Path
) -> None:
    """A PNG: the frame's picture with its masks, beside the finished map seen from the same pose.

    Each mask has the colour and number of the instance to which its fragment belongs in the finished map. Raises
    OutputError where the file cannot be written.
    """
    final: dict[int, int] = dict(zip(result.fragment_id.tolist(), result.fragment_instance.tolist(), strict=True))
    instance_of = {d.mask: final.get(d.fragment or d.instance, 0) for d in decisions if d.instance}
    pose, camera = world_from_color(frame), frame.rig.color
    rendered, labels = _view(result.voxel_index, result.voxel_instance, result.voxel_size, pose, camera, HALO)
    annotate(rendered, _notes(labels, _captions(result)))
    picture = decode_color(frame).copy() if frame.color else np.full_like(rendered, 90)
    _paint_masks(picture, masks, instance_of)
    titles = (f"Frame {frame.index}: detected masks", "The map from the same pose")
    write_png(out, _side_by_side((picture, rendered), titles))


def _view(
    index: NDArray[np.int32],
    instances: NDArray[np.int32],
    voxel_size: float,
    pose: NDArray[np.float64],
    camera: Intrinsics,
    empty: tuple[int, int, int],
    color_of: ColorOf = instance_color,
) -> tuple[Picture, NDArray[np.int32]]:
    """The voxels as lit cubes in the colours of their instances, and the instance of each pixel (-1 = none)."""
    rows = render_rows(index, voxel_size, pose, camera)
    labels = take_rows(instances, rows, np.int32(NOTHING))
    ids, place = np.unique(instances, return_inverse=True)
    palette = np.array([color_of(i) if i > 0 else STRUCTURE for i in ids.tolist()], np.uint8).reshape(-1, 3)
    colors = np.concatenate([palette[place], np.array([empty], np.uint8)])[rows]  # row -1 is the last one
    return (lit(colors, rows, index, labels, voxel_size, pose, camera) if len(index) else colors), labels


def _cutaway(result: InstanceMap, azimuth: float) -> NDArray[np.bool_]:
    """Which voxels to draw: all of instances, the floor, and of the rest what stands behind, below the ceiling."""
    background = result.voxel_instance == 0
    if not background.any():
        return np.ones(len(background), np.bool_)
    level = result.voxel_index[:, 2]
    floor, ceiling = floor_and_ceiling(level[background])
    low = level <= floor + FLOOR_METRES / result.voxel_size
    below = level < ceiling - CEILING_METRES / result.voxel_size
    aside = result.voxel_index[:, 0] * math.cos(azimuth) + result.voxel_index[:, 1] * math.sin(azimuth)
    far = aside < (aside.min() + aside.max()) / 2
    kept: NDArray[np.bool_] = ~background | low | (far & below)
    return kept


def floor_and_ceiling(level: NDArray[np.integer[Any]]) -> tuple[int, int]:
    """The fullest layer of the lower half, and of the upper half if it stands out; else nothing is a ceiling."""
    levels, count = np.unique(level, return_counts=True)
    upper = levels > (int(levels[0]) + int(levels[-1])) / 2
    floor = int(levels[~upper][count[~upper].argmax()])
    if not upper.any() or count[upper].max() < 3 * np.median(count[upper]):
        return floor, NO_CEILING
    return floor, int(levels[upper][count[upper].argmax()])


def _captions(result: InstanceMap) -> dict[int, str]:
    return {summary.id: summary.caption for summary in result.instances}


def _notes(labels: NDArray[np.int32], captions: Mapping[int, str], least: float = LEAST_AREA) -> list[Note]:
    """A name at the middle of each instance that fills enough of the picture, the largest first."""
    ids, pixels = np.unique(labels[labels > 0], return_counts=True)
    large = pixels >= least * labels.size
    order = ids[large][np.argsort(-pixels[large], kind="stable")].tolist()
    return [Note(f"{i} {shortened(captions.get(i, ''), 30)}".strip(), _middle(labels == i)) for i in order[:NOTES]]


def _middle(area: NDArray[np.bool_]) -> tuple[int, int]:
    """The point (x, y) of an area that is nearest to its centre of mass."""
    v, u = np.nonzero(area)
    nearest = int(((v - v.mean()) ** 2 + (u - u.mean()) ** 2).argmin())
    return int(u[nearest]), int(v[nearest])


def _paint_masks(picture: Picture, masks: Sequence[Mask], instance_of: dict[int, int]) -> None:
    """Fill and outline masks in their instances' colours, smaller ones on top, and name them."""
    height, width = picture.shape[:2]
    numbers = mask_image(masks, height, width)
    notes = []
    for number in sorted(range(len(masks)), key=lambda number: (-masks[number].area, number)):
        instance = instance_of.get(number, 0)
        color = instance_color(instance) if instance else UNASSIGNED
        bitmap = masks[number].bitmap(height, width)
        visible = numbers == number
        picture[visible] = picture[visible] * 0.5 + np.array(color) * 0.5
        outlines, _ = cv2.findContours(bitmap.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, outlines, -1, color, 2, cv2.LINE_AA)
        if visible.any():
            caption = shortened(masks[number].caption or masks[number].label, 30)
            notes.append(Note(f"{instance or 'none'}: {caption}", _middle(visible)))
    annotate(picture, notes)


def _side_by_side(pictures: Sequence[Picture], titles: Sequence[str]) -> Picture:
    height, width = pictures[0].shape[:2]
    sheet = np.full((height + TITLE + MARGIN, len(pictures) * (width + MARGIN) + MARGIN, 3), PAPER, np.uint8)
    for column, (picture, title) in enumerate(zip(pictures, titles, strict=True)):
        x = MARGIN + column * (width + MARGIN)
        sheet[TITLE : TITLE + height, x : x + width] = picture
        write(sheet, title, (x, TITLE - 11), scale=0.6, color=HALO, halo=0)
    return sheet


def write_png(out: Path, picture: Picture) -> None:
    """A whole file or none. Raises OutputError."""
    data = cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
    with partial_file(out) as partial:
        partial.write_bytes(data)
