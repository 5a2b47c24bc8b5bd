"""What every source gives, and how the small files of exported scenes are read: one number, matrix or stamp at a time.

All readers raise InputError naming the file and, where it has lines, the line.
"""

from __future__ import annotations

import decimal
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import Frame, Intrinsics, Pose
from openvox.formats.images import ColorFormat, check_whole, decode_png16, image_size
from openvox.formats.mcap_io import MAX_RECORD
from openvox.formats.recording import MAX_STAMP_NS, selected

NO_POSE = "pose is not finite"
Matrix = NDArray[np.float64]
TWO_CAMERAS = (
    "colour and depth have cameras of their own; nothing was resampled, colour pixels are looked up through both"
)


class StampError(InputError):
    """A file of stamps that cannot be used; the rest of the source may be sound."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """A frame of the source that is left out."""

    index: int
    reason: str


@dataclass(frozen=True, eq=False)
class Source:
    """An opened source; `frames` can be gone through once."""

    kind: str
    depth_unit: str
    """Of the source; frames have millimetres."""
    categories: Mapping[int, str]
    """Names of the truth's categories; may be empty."""
    notes: tuple[str, ...]
    """What was assumed, invented or changed, a sentence each."""
    total: int
    """Frames to come, dropped ones included; 0 if that is not known."""
    frames: Iterator[Frame | Dropped]
    late_notes: list[str] = field(default_factory=list)
    """What was noticed on the way; whole after the last frame."""


@dataclass(frozen=True, slots=True)
class Options:
    """How a source is to be read."""

    fps: float = 30.0
    """Frame rate where it has no stamps."""
    origin: tuple[int, int, int] = (0, 0, 0)
    """Whole metres to subtract from every position."""
    start: int | None = None
    end: int | None = None
    """Exclusive; both, and stride, are frame numbers."""
    stride: int = 1
    poses: Path | None = None
    """A trajectory to take instead of the source's poses, and where the depth camera sits in what it is of."""
    extrinsic: Path | None = None
    color_from_depth: Path | None = None
    """A matrix that takes depth-camera coordinates to those of the colour camera."""
    camera: str | None = None
    """Of a log: the frame whose pose is wanted. Of a folder that brings no intrinsics: a file of them."""
    world: str | None = None
    """Of a log: the frame that the map is made in."""
    topics: Mapping[str, str] = field(default_factory=dict)
    """Of a log: color, depth, color_info, depth_info or pose to the topic to take."""
    max_gap: float = 0.2
    """Seconds between two poses up to which one is made in between."""
    tolerance: float = 0.02
    """Seconds between the stamps of colour and depth up to which they are one frame."""
    invent_stamps: bool = False
    """New stamps at `fps` instead of the source's own."""
    depth_scale: float = 1.0
    """What the source's depth is multiplied by, where its unit is another than it says."""
    pose_axes: str = "RDF"
    """Where x, y and z of the camera that the poses are of point: corrections.AXES."""
    poses_inverted: bool = False
    """The source's poses are world-to-camera."""
    pose_shift: float = 0.0
    """Seconds: each picture takes the pose of so much later."""

    def __post_init__(self) -> None:
        for name, value in (("max gap", self.max_gap), ("tolerance", self.tolerance)):
            if not 0 <= value <= 3600:
                raise InputError(f"the {name} is {value} s; expected 0 to 3600 s")
        if not (math.isfinite(self.depth_scale) and 1e-4 <= self.depth_scale <= 1e4):
            raise InputError(f"the depth scale is {self.depth_scale}; expected 0.0001 to 10000")
        if not abs(self.pose_shift) <= 60:
            raise InputError(f"the pose shift is {self.pose_shift} s; expected -60 to 60 s")
        if self.poses_inverted and any(self.origin):
            raise InputError("--poses-inverted and --origin do not go together: invert the poses in a file of your own")
        if not (math.isfinite(self.fps) and 1e-3 <= self.fps <= 1e6):
            raise InputError(f"the frame rate is {self.fps}; expected 0.001 to 1000000 frames a second")
        if self.stride < 1:
            raise InputError(f"stride is {self.stride}; expected 1 or more")

    def takes(self, index: int) -> bool:
        """True if frame `index` is asked for."""
        return selected(index, self.start, self.end, self.stride)

    def stamp(self, index: int) -> int:
        """Invented stamp of a frame, nanoseconds: exact for the decimal frame rate, rounded once."""
        return nanoseconds(Decimal(index) / Decimal(repr(self.fps)))

    def chosen(self, path: Path, numbers: Sequence[int]) -> list[int]:
        """Those of the source's frame numbers that are asked for; none is an error."""
        chosen = [number for number in numbers if self.takes(number)]
        if not numbers:
            raise InputError(f"{path} has no frame with a number")
        if not chosen:
            raise InputError(
                f"{path} has frames {numbers[0]} to {numbers[-1]}; none of them is from {self.start or 0} "
                f"to before {'the end' if self.end is None else self.end} with stride {self.stride}"
            )
        return chosen


def numbered(folder: Path, suffixes: tuple[str, ...], prefix: str = "", ending: str = "") -> dict[int, Path]:
    """Files named prefix, number, ending, suffix, by number ascending; two files of one number are an error."""
    found: dict[int, Path] = {}
    for path in listed(folder):
        if not (path.suffix.lower() in suffixes and path.stem.startswith(prefix) and path.stem.endswith(ending)):
            continue
        number = path.stem.removeprefix(prefix).removesuffix(ending)
        if not _is_number(number):
            continue
        if int(number) in found:
            raise InputError(f"{found[int(number)]} and {path.name} are both frame {int(number)}; keep one of them")
        found[int(number)] = path
    return dict(sorted(found.items()))


def listed(folder: Path) -> list[Path]:
    """What lies in a folder, by name; nothing if there is none."""
    try:
        return sorted(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise InputError(f"{folder} could not be listed: {error.strerror or error}") from error


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal()


def read_bytes(path: Path) -> bytes:
    """The whole file, which must not be empty or huge."""
    try:
        size = path.stat().st_size
        if not 0 < size <= MAX_RECORD // 2:
            raise InputError(f"{path} has {size} bytes; expected 1 to {MAX_RECORD // 2}")
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path} is missing") from error
    except OSError as error:
        raise InputError(f"{path} could not be read: {error.strerror or error}") from error


def read_text(path: Path) -> str:
    """As read_bytes, of a text file."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is no text file: {error.reason} at byte {error.start}") from error


def read_picture(path: Path, size: tuple[int, int] | None = None) -> tuple[bytes, ColorFormat, tuple[int, int]]:
    """A picture's bytes, unchanged; its format, and its width and height, which must be `size` if that is given."""
    data = read_bytes(path)
    try:
        color_format, width, height = image_size(data)
        check_whole(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    _check_size(path, (width, height), size)
    return data, color_format, (width, height)


def read_grey(path: Path, size: tuple[int, int], *, or_8: bool = False) -> NDArray[np.uint16]:
    """A grey PNG of 16 bits (or_8: or of 8), of that width and height."""
    data = read_bytes(path)
    try:
        image = decode_png16(data, or_8=or_8)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    _check_size(path, (image.shape[1], image.shape[0]), size)
    return image


def _check_size(path: Path, found: tuple[int, int], expected: tuple[int, int] | None) -> None:
    if expected is not None and found != expected:
        raise InputError(
            f"{path} is {found[0]}x{found[1]} pixels; expected {expected[0]}x{expected[1]} as in the first frame"
        )


def depth_table(scale: Decimal) -> NDArray[np.uint16]:
    """(65536,): raw depth, in so many units a metre, to millimetres, rounded half to even from the exact quotient."""
    factor = Fraction(1000) / Fraction(scale)
    raw = np.arange(1 << 16, dtype=object) * factor.numerator
    whole, rest = raw // factor.denominator, raw % factor.denominator
    up = (2 * rest > factor.denominator) | ((2 * rest == factor.denominator) & (whole % 2 == 1))
    return np.asarray(whole + up, np.uint16)


def parse_matrix(text: str, where: str) -> Matrix:
    """(n, n) float64 of 9 or 16 numbers, row by row; numbers that are not finite are let through."""
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError as error:
        raise InputError(f"{where}: {error}; expected 16 numbers") from error
    side = math.isqrt(len(numbers))
    if side not in (3, 4) or side * side != len(numbers):
        raise InputError(f"{where} holds {len(numbers)} numbers; expected a matrix of 4x4 (or 3x3 intrinsics)")
    return np.array(numbers, np.float64).reshape(side, side)


def pose_of(matrix: Matrix, origin: tuple[int, int, int], where: str) -> Pose | None:
    """Camera-to-world pose with the origin subtracted; None if a number is not finite, as where tracking was lost."""
    if matrix.shape != (4, 4):
        raise InputError(f"{where}: a pose has 16 numbers, this has {matrix.size}")
    if not np.isfinite(matrix).all():
        return None
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > 1e-3:
        raise InputError(
            f"{where}: the last row of the pose is {matrix[3].tolist()}; expected 0 0 0 1 (is the matrix transposed?)"
        )
    try:
        pose = Pose.from_matrix(matrix)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    x, y, z = (value - metres for value, metres in zip(pose.translation, origin, strict=True))
    return replace(pose, translation=(x, y, z))


def read_transform(path: Path) -> Pose:
    """A rigid transform of a file with a 4x4 matrix, metres."""
    pose = pose_of(parse_matrix(read_text(path), str(path)), (0, 0, 0), str(path))
    if pose is None:
        raise InputError(f"{path} holds a number that is not finite; expected a 4x4 matrix")
    return pose


def camera_of(matrix: Matrix, size: tuple[int, int], where: str) -> Intrinsics:
    """A pinhole camera of a 3x3 or 4x4 intrinsic matrix and a picture's width and height."""
    if abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]) or abs(matrix[1, 0]) > 0:
        raise InputError(f"{where}: the matrix has a skew of {matrix[0, 1]}; expected a pinhole camera without")
    try:
        return Intrinsics(*size, *(float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def camera_file(path: Path, size: tuple[int, int]) -> Intrinsics:
    """A camera of a file: a 3x3 or 4x4 matrix, or the four numbers fx fy cx cy."""
    words = read_text(path).split()
    if len(words) != 4:
        return camera_of(parse_matrix(" ".join(words), str(path)), size, str(path))
    try:
        fx, fy, cx, cy = (float(word) for word in words)
        return Intrinsics(*size, fx, fy, cx, cy)
    except (ValueError, InputError) as error:
        raise InputError(f"{path}: {error}; expected fx fy cx cy") from error


def scaled(camera: Intrinsics, size: tuple[int, int]) -> Intrinsics:
    """The same camera with another picture size (pixel centres are integers, so edges lie at -0.5)."""
    x, y = size[0] / camera.width, size[1] / camera.height
    return Intrinsics(*size, camera.fx * x, camera.fy * y, (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5)


def read_stamps(path: Path, count: int) -> list[int]:
    """Nanoseconds of so many lines of decimal seconds, each exact, rising."""
    lines = read_text(path).split()
    if len(lines) != count:
        raise StampError(f"{path} has {len(lines)} stamps; expected {count}, one for each frame of the source")
    stamps: list[int] = []
    for line, text in enumerate(lines, 1):
        try:
            seconds = Decimal(text)
        except decimal.InvalidOperation:
            seconds = Decimal("nan")
        if not 0 <= seconds < MAX_STAMP_NS // 10**9 if seconds.is_finite() else True:
            raise StampError(f"{path}, line {line}: stamp {text!r}; expected seconds between 0 and 2**31")
        stamp = nanoseconds(seconds)
        if stamps and stamp <= stamps[-1]:
            raise StampError(f"{path}, line {line}: stamp {text} comes not after the one before; stamps must rise")
        stamps.append(stamp)
    return stamps


def nanoseconds(seconds: Decimal) -> int:
    """Of seconds, rounded half to even; exact to 28 digits."""
    return int((seconds * 10**9).to_integral_value(decimal.ROUND_HALF_EVEN))
