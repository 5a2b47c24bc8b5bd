"""Stray Scanner (iPhone, iPad): rgb.mp4, depth/000000.png in millimetres, camera_matrix.csv and odometry.csv.

Depth has a smaller picture of the same camera. Colour comes out of a film, so that its pictures are stored as JPEG.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import Frame, Pose, Rig
from openvox.formats.images import encode_jpeg
from openvox.formats.recording import MAX_STAMP_NS
from openvox.sources import shots
from openvox.sources.source import (
    Dropped,
    Options,
    Source,
    camera_of,
    nanoseconds,
    numbered,
    parse_matrix,
    read_grey,
    read_text,
    scaled,
)
from openvox.sources.transforms import placed

WANTED = ("rgb.mp4", "depth/", "camera_matrix.csv", "odometry.csv")
_COLUMNS = ("timestamp", "x", "y", "z", "qx", "qy", "qz", "qw")
QUALITY = 95


def missing(folder: Path, options: Options) -> list[str]:
    """What a folder lacks to be such a scan."""
    return [name for name in WANTED if not (folder / name).exists()]


def read(folder: Path, options: Options) -> Source:
    """Opens a scan. Raises InputError, also while iterating."""
    depth = numbered(folder / "depth", (".png",))
    rows = _odometry(folder / "odometry.csv")
    numbers = sorted(number for number in depth if number in rows)
    if not numbers:
        raise InputError(f"{folder}: no file of depth/ has a line in odometry.csv")
    chosen = options.chosen(folder, numbers)
    size = _film_size(folder / "rgb.mp4")
    path = folder / "camera_matrix.csv"
    color = camera_of(parse_matrix(read_text(path).replace(",", " "), str(path)), size, str(path))
    rig = Rig(scaled(color, shots.size_of(depth[chosen[0]])), color)
    notes = (
        f"colour was taken out of the film and stored as JPEG of quality {QUALITY}",
        "intrinsics were scaled from colour's pixels to depth's: both are of one camera",
    )
    return Source("stray", "mm", {}, notes, len(chosen), _frames(folder, depth, rows, chosen, rig, options))


def _odometry(path: Path) -> dict[int, tuple[int, Pose]]:
    """Stamp in nanoseconds and pose by frame number."""
    lines = csv.reader(read_text(path).splitlines(), skipinitialspace=True)
    head = [name.strip() for name in next(lines, [])]
    if not {*_COLUMNS, "frame"} <= set(head):
        raise InputError(f"{path} has columns {', '.join(head)[:200]}; expected frame, {', '.join(_COLUMNS)}")
    found: dict[int, tuple[int, Pose]] = {}
    for line, words in enumerate(lines, 2):
        row = dict(zip(head, words, strict=False))
        try:
            seconds = Decimal(row["timestamp"])
            x, y, z, qx, qy, qz, qw = (float(row[name]) for name in _COLUMNS[1:])
            if not (seconds.is_finite() and 0 <= seconds < MAX_STAMP_NS // 10**9):
                raise ValueError(f"stamp {seconds}")
            found[int(row["frame"])] = nanoseconds(seconds), Pose((qx, qy, qz, qw), (x, y, z))
        except (KeyError, ValueError, InvalidOperation, InputError) as error:
            raise InputError(f"{path}, line {line}: {error!s:.200}; expected a stamp, a frame and a pose") from error
    return found


def _film(path: Path) -> Any:
    import cv2

    film = cv2.VideoCapture(str(path))
    if not film.isOpened():
        raise InputError(f"{path} cannot be decoded by this OpenCV; expected a film that it knows, H.264 or HEVC")
    film.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return film


def _film_size(path: Path) -> tuple[int, int]:
    film = _film(path)
    try:
        return _next(film, path).shape[1::-1]
    finally:
        film.release()


def _next(film: Any, path: Path) -> NDArray[np.uint8]:
    """The film's next picture, BGR."""
    there, image = film.read()
    if not there:
        raise InputError(f"{path} ends before the last depth picture; is it whole?")
    return np.asarray(image, np.uint8)


def _frames(
    folder: Path,
    depth: dict[int, Path],
    rows: dict[int, tuple[int, Pose]],
    chosen: list[int],
    rig: Rig,
    options: Options,
) -> Iterator[Frame | Dropped]:
    film, shown, last = _film(folder / "rgb.mp4"), -1, -1
    size = (rig.depth.width, rig.depth.height)
    try:
        for number in chosen:
            while shown < number - 1 and film.grab():
                shown += 1
            image, shown = _next(film, folder / "rgb.mp4"), number
            stamp, pose = rows[number]
            if stamp <= last:
                yield Dropped(number, "a stamp that is not after that of the frame before")
                continue
            last = stamp
            color = encode_jpeg(np.ascontiguousarray(image[..., ::-1]), QUALITY)
            here = placed(pose, Pose.identity(), options.origin)
            yield Frame(number, stamp, here, rig, read_grey(depth[number], size), color, "jpeg")
    finally:
        film.release()
