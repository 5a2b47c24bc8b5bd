"""Logged pictures to what a recording holds: depth in millimetres, colour as a JPEG or PNG file, both without
distortion."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import MAX_IMAGE_SIDE, DepthImage, Intrinsics
from openvox.formats.images import MAX_PIXELS, ColorFormat, check_whole, decode_png16, encode_png, image_size
from openvox.formats.robot_log import Calibration, Picture
from openvox.sources.source import scaled

COLORS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8UC1": 1, "8UC3": 3, "8UC4": 4}
"""Encodings of colour and their channels; 8UC3 and 8UC4 are taken as BGR, as OpenCV has them."""
DEPTHS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
METRES_HEADER = struct.Struct("<iff")


def is_depth(picture: Picture) -> bool:
    """True if the picture's encoding is one of depth."""
    return picture.encoding in DEPTHS or picture.encoding == "compressedDepth"


def size_of(picture: Picture) -> tuple[int, int]:
    """Width and height. Raises InputError."""
    if picture.encoding == "compressed":
        return image_size(bytes(picture.data))[1:]
    if picture.encoding == "compressedDepth":
        return image_size(bytes(picture.data[METRES_HEADER.size :]))[1:]
    return picture.width, picture.height


def decode_depth(picture: Picture) -> DepthImage:
    """Millimetres, 0 = no measurement; metres are rounded half to even. Raises InputError."""
    if picture.encoding == "compressedDepth":
        return _decode_compressed_depth(bytes(picture.data))
    if picture.encoding == "compressed":
        return decode_png16(bytes(picture.data))
    if picture.encoding not in DEPTHS:
        raise InputError(f"depth is {picture.encoding!r}; expected {', '.join(DEPTHS)} or compressedDepth")
    image = _pixels(picture, np.dtype(DEPTHS[picture.encoding]), 1)[..., 0]
    return millimetres(image) if image.dtype.kind == "f" else image.astype(np.uint16)


def millimetres(metres: NDArray[Any]) -> DepthImage:
    """Of metres as float; what is not finite, not above 0, or beyond 65.535 m becomes 0."""
    with np.errstate(invalid="ignore", over="ignore"):
        rounded = np.rint(metres.astype(np.float64) * 1000.0)
        return np.where((rounded > 0) & (rounded < 65536), rounded, 0).astype(np.uint16)


def _decode_compressed_depth(data: bytes) -> DepthImage:
    """ROS compressed_depth_image_transport: a format and two factors, then a PNG of 16 bits."""
    if len(data) < METRES_HEADER.size:
        raise InputError(f"compressedDepth of {len(data)} bytes; expected a header of {METRES_HEADER.size} and a PNG")
    _, a, b = METRES_HEADER.unpack_from(data)
    raw = decode_png16(data[METRES_HEADER.size :])
    if a == 0.0 and b == 0.0:
        return raw
    with np.errstate(divide="ignore"):  # metres as inverse depth
        return millimetres(np.where(raw > 0, a / (raw.astype(np.float64) - b), 0.0))


def _pixels(picture: Picture, dtype: np.dtype[Any], channels: int) -> NDArray[Any]:
    """(height, width, channels) of a picture that is not compressed."""
    width, height, step = picture.width, picture.height, picture.step
    if not (0 < width <= MAX_IMAGE_SIDE and 0 < height <= MAX_IMAGE_SIDE and width * height <= MAX_PIXELS):
        raise InputError(f"the picture is {width}x{height} pixels")
    row = width * channels * dtype.itemsize
    if step < row or len(picture.data) < step * (height - 1) + row:
        raise InputError(
            f"the picture of {width}x{height} pixels {picture.encoding} has rows of {step} bytes, "
            f"{len(picture.data)} in all; expected rows of {row}"
        )
    data = np.frombuffer(picture.data, np.uint8)
    rows = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1), writeable=False)
    packed = np.ascontiguousarray(rows).view(dtype.newbyteorder(">" if picture.big_endian else "<"))
    return packed.reshape(height, width, channels)


def decode_rgb(picture: Picture) -> NDArray[np.uint8]:
    """(height, width, 3) RGB of a colour picture. Raises InputError."""
    import cv2

    if picture.encoding == "compressed":
        size_of(picture)  # before anything of the size that the file claims is allocated
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), flags)
        if image is None:
            raise InputError("the colour picture cannot be decoded")
        return np.ascontiguousarray(image[..., ::-1])
    if picture.encoding not in COLORS:
        raise InputError(f"colour is {picture.encoding!r}; expected {', '.join(COLORS)}, JPEG or PNG")
    image = _pixels(picture, np.dtype(np.uint8), COLORS[picture.encoding])
    if image.shape[2] == 1:
        return np.repeat(image, 3, axis=2)
    rgb = image[..., :3] if picture.encoding.startswith("rgb") else image[..., 2::-1]
    return np.ascontiguousarray(rgb)


@dataclass
class Camera:
    """A camera of the log: its pinhole without distortion, and how its pictures come to have none."""

    intrinsics: Intrinsics
    k: tuple[float, ...]
    d: tuple[float, ...]
    model: str
    _maps: Any = field(default=None)

    @classmethod
    def of(cls, calibration: Calibration, size: tuple[int, int], rectified: bool) -> Camera:
        """For pictures of that size. rectified: they are so already, and P is their camera. Raises InputError."""
        k, d = calibration.k, calibration.d if any(calibration.d) and not rectified else ()
        if rectified and len(calibration.p) == 12 and calibration.p[0] > 0:
            p = calibration.p
            k = (p[0], p[1], p[2], p[4], p[5], p[6], 0.0, 0.0, 1.0)
        if len(k) != 9 or not k[0] > 0:
            raise InputError(f"the calibration has K {list(k)}; expected 9 numbers, the first above 0")
        given = Intrinsics(calibration.width or size[0], calibration.height or size[1], k[0], k[4], k[2], k[5])
        if abs(given.width * size[1] - given.height * size[0]) > max(size):
            raise InputError(
                f"the calibration is of {given.width}x{given.height} pixels, the picture of {size[0]}x{size[1]}"
            )
        fit = scaled(given, size) if (given.width, given.height) != size else given
        return cls(fit, (fit.fx, 0.0, fit.cx, 0.0, fit.fy, fit.cy, 0.0, 0.0, 1.0), d, calibration.model)

    @property
    def distorted(self) -> bool:
        """True if pictures must be rectified."""
        return bool(self.d)

    def rectify(self, image: NDArray[Any]) -> NDArray[Any]:
        """The picture without distortion, in the same size; depth by the nearest pixel, colour smoothly."""
        import cv2

        size = (self.intrinsics.width, self.intrinsics.height)
        if image.shape[1::-1] != size:
            raise InputError(f"the picture is {image.shape[1]}x{image.shape[0]} pixels, its camera {size[0]}x{size[1]}")
        if self._maps is None:
            self._maps = self._make_maps()
        along, down = self._maps
        return np.asarray(cv2.remap(image, along, down, cv2.INTER_LINEAR if image.ndim == 3 else cv2.INTER_NEAREST))

    def _make_maps(self) -> Any:
        import cv2

        k, d = np.array(self.k).reshape(3, 3), np.array(self.d)
        size = (self.intrinsics.width, self.intrinsics.height)
        try:
            if self.model in ("equidistant", "fisheye", "kannala_brandt"):
                return cv2.fisheye.initUndistortRectifyMap(k, d[:4], np.eye(3), k, size, cv2.CV_32FC1)
            return cv2.initUndistortRectifyMap(k, d, np.eye(3), k, size, cv2.CV_32FC1)
        except cv2.error as error:
            raise InputError(
                f"distortion {list(self.d)} of model {self.model!r} cannot be removed ({error})"
            ) from error


def color_file(picture: Picture, camera: Camera) -> tuple[bytes, ColorFormat]:
    """The log's JPEG or PNG, unchanged; a PNG of what was not compressed, or had to be rectified."""
    if picture.encoding == "compressed" and not camera.distorted:
        data = bytes(picture.data)
        check_whole(data)
        return data, image_size(data)[0]
    image = decode_rgb(picture)
    return encode_png(camera.rectify(image) if camera.distorted else image), "png"


def depth_image(picture: Picture, camera: Camera) -> DepthImage:
    """Millimetres, without distortion."""
    image = decode_depth(picture)
    return np.asarray(camera.rectify(image), np.uint16) if camera.distorted else image
