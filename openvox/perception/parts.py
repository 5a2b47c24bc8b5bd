"""A frame parted into regions, by depth, by height above a support, by colour on even ground; in colour pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Frame
from openvox.perception.bodies import bodies_of
from openvox.perception.geometry import smooth
from openvox.perception.joined import joined
from openvox.perception.parameters import GeometryParameters, OfflineParameters
from openvox.perception.patches import tops, with_patches
from openvox.perception.planes import Room
from openvox.perception.regions import at_color_pixels, at_depth_pixels, color_pixels_of, depth_at_color_pixels
from openvox.perception.segments import Labels, planes_at, segments
from openvox.perception.supports import bearers, free_standing, split_supports
from openvox.perception.surface import Flags, Floats, Surface, depth_in_metres, surface
from openvox.perception.trim import trim
from openvox.perception.wording import Form, forms


@dataclass(frozen=True, eq=False)
class Parts:
    """Regions of a frame, numbered from 1: pieces up to `pieces`, the rest split off what they stand or hang on.

    labels, background (the room's planes), z (metres, 0 = unknown): (height, width) in colour pixels. depths: of each
    region, the median of z. form: of each region that depth knows, the words for it. on: of each region that stands on
    something, the number of that, or FLOOR."""

    labels: Labels
    background: Flags
    z: Floats
    depths: Floats
    form: dict[int, Form]
    pieces: int
    on: dict[int, int] = field(default_factory=dict)


def parted(
    frame: Frame, rgb: NDArray[np.uint8] | None, room: Room, geometry: GeometryParameters, offline: OfflineParameters
) -> Parts:
    """The regions of a frame. rgb: its colour; without it nothing is parted by colour."""
    pose = frame.world_from_depth
    seen = surface(frame.depth, frame.rig.depth, geometry.near, geometry.far)
    planes = planes_at(seen, room, pose)
    lab = None if rgb is None else _lab(frame, seen, rgb)
    labels, solid = segments(seen, planes > 0, geometry, offline.stem_pixels)
    labels = joined(labels, solid, seen, room, pose, geometry)
    if lab is not None:
        labels = with_patches(labels, tops(labels, seen, room.up_in(pose)), lab, offline)
    pieces = int(labels.max())
    labels = split_supports(labels, seen, room, pose, geometry, offline)
    bodies = bodies_of(labels, seen, room, pose, geometry)
    on = free_standing(bodies, labels, room, offline) | bearers(bodies, offline)
    strips = [n for n in trim(bodies, labels, room, geometry.piece_pixels) if n <= pieces and n not in on]
    if lab is not None:
        labels = with_patches(labels, _walls(planes, room), lab, offline)
    ground = int(labels.max()) + 1
    of_room = np.isin(labels, strips) | ((labels == 0) & (planes > 0))
    marked = np.where(of_room, ground, labels).astype(np.int32)
    marked = at_depth_pixels(marked, seen, depth_in_metres(frame.depth, geometry.near, geometry.far))
    marked = smooth(at_color_pixels(marked, frame.depth, frame.rig))
    background = marked == ground
    return Parts(
        labels=np.where(background, 0, marked).astype(np.int32),
        background=background,
        z=depth_at_color_pixels(frame.depth, frame.rig),
        depths=_median_depths(labels, seen.points[2]),
        form=forms(labels, seen, room, pose),
        pieces=pieces,
        on=on,
    )


def _walls(planes: NDArray[np.int8], room: Room) -> Iterator[Flags]:
    """Where each upright plane is: floors have patterns, walls have pictures."""
    for i, plane in enumerate(room.planes, 1):
        if plane in room.walls:
            yield planes == i


def _lab(frame: Frame, seen: Surface, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(h, w, 3) CIE Lab of the working pixels, slightly blurred; where colour does not reach, that of the rim."""
    import cv2

    blurred = cv2.blur(rgb, (3, 3))
    row, column = color_pixels_of(seen, frame.rig)
    picked = blurred[row, column].astype(np.float32) * np.float32(1 / 255)
    return np.asarray(cv2.cvtColor(picked, cv2.COLOR_RGB2Lab), np.float32)


def _median_depths(labels: Labels, z: Floats) -> Floats:
    """(regions + 1,) metres, 0 for none."""
    flat = labels.reshape(-1)
    where = np.flatnonzero(flat)
    where = where[np.lexsort((z.reshape(-1)[where], flat[where]))]
    count = int(labels.max()) + 1
    bounds = np.searchsorted(flat[where], np.arange(count + 1))
    middle = (bounds[:-1] + bounds[1:]) // 2
    depths = np.append(z.reshape(-1)[where], np.float32(0))[np.minimum(middle, len(where))]
    result: Floats = np.where(np.diff(bounds) > 0, depths, np.float32(0)).astype(np.float32)
    return result
