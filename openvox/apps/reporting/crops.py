"""Where the recording shows each instance best: pieces of its pictures, with what the map says outlined."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from openvox.core.colors import instance_color
from openvox.core.errors import InputError
from openvox.core.types import Frame, InstanceMap, Intrinsics
from openvox.formats.images import decode_color, encode_jpeg
from openvox.formats.recording import read_frames, recording_info
from openvox.view.render import render_map
from openvox.view.viewpoint import world_from_color

LOOKS = 90
"""Frames that are searched, evenly over the recording."""
VIEWS = 2
APART = 0.08
"""Of the recording that lies between two views of an instance, at least."""
CUT = 0.6
"""What an instance that reaches the edge of the picture counts."""
LEAST_AREA = 0.0005
"""Of the picture that an instance must fill to be shown from there."""
SEARCH_WIDTH = 320
LARGEST = (220, 150)
"""Width and height that a crop is shrunk to."""
BORDER = 0.12
MOST = 400
"""Instances that get crops, the surest first: a page is to be sent around."""
QUALITY = 80


@dataclass(frozen=True, slots=True)
class Crop:
    """A JPEG file, and the frame that it was cut from."""

    frame: int
    jpeg: bytes
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class _Sight:
    """How well a frame shows an instance, and where: left, top, right, bottom as shares of the picture."""

    score: float
    frame: int
    box: tuple[float, float, float, float]


def crops(result: InstanceMap, recording: Path) -> dict[int, tuple[Crop, ...]]:
    """The best views of each instance, from where the map, drawn from the frames' poses, shows most of it.

    Raises InputError where the recording cannot be read, or has no colour."""
    found = recording_info(recording)
    if not found.has_color:
        raise InputError(f"{recording} has no colour")
    stride = max(1, -(-(found.last - found.first + 1) // LOOKS))
    order = np.lexsort((result.instance_id, -result.instance_confidence))[:MOST]
    wanted = set(result.instance_id[order].tolist())
    sights: dict[int, list[_Sight]] = {}
    for frame in read_frames(recording, start=found.first, stride=stride, truth=False):
        for instance, sight in _sights(frame, result):
            if instance in wanted:
                sights.setdefault(instance, []).append(sight)
    best = {i: _best(each, APART * (found.last - found.first)) for i, each in sights.items()}
    return _cut(result, recording, best, (found.first, stride))


def _sights(frame: Frame, result: InstanceMap) -> Iterable[tuple[int, _Sight]]:
    labels = _labels(frame, result, SEARCH_WIDTH)
    height, width = labels.shape
    ids, pixels = np.unique(labels[labels > 0], return_counts=True)
    for instance, count in zip(ids.tolist(), pixels.tolist(), strict=True):
        if count < LEAST_AREA * labels.size:
            continue
        where = labels == instance
        columns, rows = np.flatnonzero(where.any(0)), np.flatnonzero(where.any(1))
        x0, y0, x1, y1 = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
        whole = x0 > 0 and y0 > 0 and x1 < width and y1 < height
        box = (x0 / width, y0 / height, x1 / width, y1 / height)
        yield instance, _Sight(count / labels.size * (1 if whole else CUT), frame.index, box)


def _labels(frame: Frame, result: InstanceMap, width: int) -> NDArray[np.int32]:
    """Instance of each pixel of the frame's colour camera, shrunk to a width."""
    camera = frame.rig.color
    scale = min(1.0, width / camera.width)
    small = Intrinsics(
        max(1, round(camera.width * scale)),
        max(1, round(camera.height * scale)),
        camera.fx * scale,
        camera.fy * scale,
        (camera.cx + 0.5) * scale - 0.5,
        (camera.cy + 0.5) * scale - 0.5,
    )
    return render_map(result.voxel_index, result.voxel_instance, result.voxel_size, world_from_color(frame), small)


def _best(sights: list[_Sight], apart: float) -> list[_Sight]:
    """The best, and the best of those that are far enough from it."""
    chosen: list[_Sight] = []
    for sight in sorted(sights, key=lambda sight: (-sight.score, sight.frame)):
        if len(chosen) < VIEWS and all(abs(sight.frame - other.frame) >= apart for other in chosen):
            chosen.append(sight)
    return chosen


def _cut(
    result: InstanceMap, recording: Path, best: Mapping[int, list[_Sight]], frames: tuple[int, int]
) -> dict[int, tuple[Crop, ...]]:
    by_frame: dict[int, list[tuple[int, _Sight]]] = {}
    for instance in sorted(best):
        for sight in best[instance]:
            by_frame.setdefault(sight.frame, []).append((instance, sight))
    made: dict[tuple[int, int], Crop] = {}
    for frame in read_frames(recording, start=frames[0], stride=frames[1], truth=False):
        if frame.index in by_frame:
            picture = decode_color(frame)
            labels = _labels(frame, result, frame.rig.color.width)
            for instance, sight in by_frame[frame.index]:
                made[instance, sight.frame] = _crop(picture, labels == instance, instance, sight)
    return {i: tuple(made[i, sight.frame] for sight in best[i]) for i in sorted(best)}


def _crop(picture: NDArray[np.uint8], mask: NDArray[np.bool_], instance: int, sight: _Sight) -> Crop:
    """The piece around the instance, with its outline in its colour."""
    height, width = picture.shape[:2]
    x0, y0, x1, y1 = (share * side for share, side in zip(sight.box, (width, height) * 2, strict=True))
    border = BORDER * max(x1 - x0, y1 - y0) + 6
    left, top = max(0, int(x0 - border)), max(0, int(y0 - border))
    right, bottom = min(width, int(x1 + border) + 1), min(height, int(y1 + border) + 1)
    piece = picture[top:bottom, left:right]
    scale = min(LARGEST[0] / piece.shape[1], LARGEST[1] / piece.shape[0])
    size = (max(1, round(piece.shape[1] * scale)), max(1, round(piece.shape[0] * scale)))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    shown = np.ascontiguousarray(cv2.resize(piece, size, interpolation=way), np.uint8)
    outline = cv2.resize(mask[top:bottom, left:right].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    contours, _ = cv2.findContours(outline, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(shown, contours, -1, instance_color(instance), 1, cv2.LINE_AA)
    return Crop(sight.frame, encode_jpeg(shown, QUALITY), *size)
