"""ScanNet's `.sens`: one file of JPEG colour, packed depth and poses. Read frame by frame; every length is checked."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import BinaryIO

import numpy as np

from openvox.core.errors import InputError
from openvox.core.types import DepthImage, Frame, Pose, Rig
from openvox.formats.images import check_whole, image_size
from openvox.formats.mcap_io import MAX_RECORD
from openvox.formats.recording import MAX_STAMP_NS
from openvox.sources.source import (
    NO_POSE,
    TWO_CAMERAS,
    Dropped,
    Matrix,
    Options,
    Source,
    camera_of,
    depth_table,
    pose_of,
)

WANTED = ("*.sens",)
VERSION = 4
_HEAD = struct.Struct("<16f16f16f16fiiIIIIfQ")
_FRAME = struct.Struct("<16fQQQQ")
_COLORS = {1: "png", 2: "jpeg"}
_RAW, _ZLIB = 0, 1
MAX_PIXELS = 1 << 26


def missing(path: Path, options: Options) -> list[str]:
    """What is missing for it to be such a file."""
    return [] if path.suffix == ".sens" and path.is_file() else ["a .sens file"]


@dataclass(frozen=True, slots=True)
class _Header:
    color_matrix: Matrix
    color_pose: Matrix
    depth_matrix: Matrix
    depth_pose: Matrix
    depth_codec: int
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    shift: float
    frames: int


def read(path: Path, options: Options) -> Source:
    """Opens a file. Raises InputError, also while iterating."""
    with _opened(path) as file:
        header = _header(path, file)
        first = next(_records(path, file, header), None)
    if first is None:
        raise InputError(f"{path} has no frame")
    chosen = options.chosen(path, range(header.frames))
    invented = first.stamp_us == 0
    rig = _rig(path, header)
    unit = f"1/{header.shift:g} m"
    notes = [f"stamps were invented at {options.fps:g} frames a second: the file has none"] if invented else []
    notes += [] if rig.registered else [TWO_CAMERAS]
    frames = _frames(path, header, rig, invented, options)
    return Source("sens", "mm" if header.shift == 1000 else unit, {}, tuple(notes), len(chosen), frames)


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise InputError(f"{path} could not be read: {error.strerror or error}") from error


def _take(path: Path, file: BinaryIO, size: int) -> bytes:
    """So many bytes, which must be there."""
    left = os.fstat(file.fileno()).st_size - file.tell()
    if size > min(left, MAX_RECORD):
        raise InputError(f"{path} is cut off or damaged at byte {file.tell()}: {size} bytes follow, {left} are there")
    return file.read(size)


def _header(path: Path, file: BinaryIO) -> _Header:
    version, length = struct.unpack("<IQ", _take(path, file, 12))
    if version != VERSION:
        raise InputError(f"{path} has version {version} of .sens; expected {VERSION}")
    _take(path, file, length)
    numbers = _HEAD.unpack(_take(path, file, _HEAD.size))
    color, color_pose, depth, depth_pose = np.array(numbers[:64], np.float64).reshape(4, 4, 4)
    color_codec, depth_codec, cw, ch, dw, dh, shift, frames = numbers[64:]
    if color_codec not in _COLORS or depth_codec not in (_RAW, _ZLIB):
        raise InputError(
            f"{path} packs colour by codec {color_codec} and depth by {depth_codec}; openvox reads PNG and JPEG (1, 2) "
            "and raw and zlib depth (0, 1)"
        )
    if not 1000 <= shift <= 10**6 or not 0 < dw * dh <= MAX_PIXELS:
        raise InputError(f"{path}: depth of {dw}x{dh} pixels in units of 1/{shift} m; expected 1000 to 1000000 a metre")
    left = os.fstat(file.fileno()).st_size - file.tell()
    if frames * _FRAME.size > left:
        raise InputError(f"{path} is cut off or damaged: it states {frames} frames, and {left} bytes follow")
    sizes = (cw, ch), (dw, dh)
    return _Header(color, color_pose, depth, depth_pose, depth_codec, *sizes, float(shift), frames)


def _rig(path: Path, header: _Header) -> Rig:
    color = camera_of(header.color_matrix, header.color_size, f"{path}, colour intrinsics")
    depth = camera_of(header.depth_matrix, header.depth_size, f"{path}, depth intrinsics")
    between = []
    for name, matrix in (("colour", header.color_pose), ("depth", header.depth_pose)):
        known = np.isfinite(matrix).all() and abs(matrix[3, 3] - 1.0) < 1e-3
        between.append(pose_of(matrix, (0, 0, 0), f"{path}, {name} extrinsics") if known else None)
    if between[1] not in (None, Pose.identity()):
        raise InputError(f"{path}: the depth camera's extrinsics are no identity; expected poses of the camera itself")
    return Rig(depth, color, between[0] or Pose.identity())


@dataclass(frozen=True, eq=False, slots=True)
class _Record:
    matrix: Matrix
    stamp_us: int
    color: bytes
    depth: bytes


def _records(path: Path, file: BinaryIO, header: _Header) -> Iterator[_Record]:
    """The frames from here on."""
    for _ in range(header.frames):
        *matrix, color_stamp, depth_stamp, color_size, depth_size = _FRAME.unpack(_take(path, file, _FRAME.size))
        color, depth = _take(path, file, color_size), _take(path, file, depth_size)
        yield _Record(np.array(matrix, np.float64).reshape(4, 4), depth_stamp or color_stamp, color, depth)


def _frames(path: Path, header: _Header, rig: Rig, invented: bool, options: Options) -> Iterator[Frame | Dropped]:
    table, last = depth_table(Decimal(repr(header.shift))), -1
    with _opened(path) as file:
        _header(path, file)
        for number, record in enumerate(_records(path, file, header)):
            if not options.takes(number):
                continue
            where = f"{path}, frame {number}"
            pose = Pose.identity() if options.poses else pose_of(record.matrix, options.origin, where)
            stamp = options.stamp(number) if invented else record.stamp_us * 1000
            if pose is None:
                yield Dropped(number, NO_POSE)
            elif not last < stamp < MAX_STAMP_NS:
                yield Dropped(number, "a stamp that is not after that of the frame before")
            else:
                last = stamp
                yield _frame(where, number, stamp, pose, record, header, rig, table)


def _frame(
    where: str, number: int, stamp: int, pose: Pose, record: _Record, header: _Header, rig: Rig, table: DepthImage
) -> Frame:
    try:
        check_whole(record.color)
        color_format = image_size(record.color)[0]
    except InputError as error:
        raise InputError(f"{where}, colour: {error}") from error
    raw = _unpacked(where, record.depth, header)
    return Frame(number, stamp, pose, rig, table[raw], record.color, color_format)


def _unpacked(where: str, data: bytes, header: _Header) -> DepthImage:
    width, height = header.depth_size
    if header.depth_codec == _ZLIB:
        try:
            data = zlib.decompressobj().decompress(data, 2 * width * height + 1)
        except zlib.error as error:
            raise InputError(f"{where}, depth: {error}") from error
    if len(data) != 2 * width * height:
        raise InputError(f"{where}: depth has {len(data)} bytes; expected {2 * width * height} for {width}x{height}")
    return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)
