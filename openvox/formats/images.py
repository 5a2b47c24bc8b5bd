"""Pictures in files: size and wholeness from their bytes, pixels through OpenCV (imported when needed)."""

from __future__ import annotations

import struct
import zlib
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import MAX_IMAGE_SIDE, Frame

ColorFormat = Literal["jpeg", "png"]
MAX_PIXELS = 1 << 26
"""More are refused: a few bytes of PNG may claim gigabytes."""

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_GREY = 0


def image_size(data: bytes) -> tuple[ColorFormat, int, int]:
    """Format, width and height of a JPEG or PNG file, from its header. Raises InputError."""
    if data.startswith(_PNG):
        width, height, _, _ = _png_header(data)
        return "png", width, height
    if data.startswith(_JPEG):
        return "jpeg", *_jpeg_size(data)
    raise InputError(f"the picture begins with {data[:4].hex() or 'nothing'}; expected a JPEG or PNG file")


def check_whole(data: bytes) -> None:
    """Raises InputError if a JPEG or PNG file is cut off, or a PNG fails its checksums."""
    if data.startswith(_PNG):
        _check_png(data)
    elif b"\xff\xd9" not in data[-4096:]:
        raise InputError("the JPEG file is cut off: its end mark is missing")


def decode_color(frame: Frame) -> NDArray[np.uint8]:
    """(height, width, 3) RGB in colour pixels, turned by no orientation tag. Raises InputError."""
    import cv2

    where = f"frame {frame.index}"
    if not frame.color:
        raise InputError(f"{where} has no colour; the recording was made without it")
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(frame.color, np.uint8), flags)
    if image is None:
        raise InputError(f"{where}: the {frame.color_format} picture cannot be decoded")
    expected = (frame.rig.color.height, frame.rig.color.width, 3)
    if image.shape != expected:
        raise InputError(f"{where}: colour is {image.shape[1]}x{image.shape[0]}; expected {expected[1]}x{expected[0]}")
    return np.ascontiguousarray(image[..., ::-1])


def decode_png16(data: bytes, *, or_8: bool = False) -> NDArray[np.uint16]:
    """A grey PNG of 16 bits (or_8: or of 8) as (height, width) uint16. Raises InputError for any other picture."""
    import cv2

    if not data.startswith(_PNG):
        raise InputError(f"the file begins with {data[:4].hex() or 'nothing'}; expected a PNG")
    width, height, bits, kind = _png_header(data)
    if kind != _GREY or bits not in ((8, 16) if or_8 else (16,)):
        raise InputError(
            f"the PNG has {bits} bits and colour type {kind}; expected {'8 or ' * or_8}16 bits of grey (type {_GREY})"
        )
    _check_png(data)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype != f"uint{bits}" or image.shape != (height, width):
        raise InputError(f"the PNG of {width}x{height} pixels cannot be decoded as {bits} bits of grey")
    return np.asarray(image, np.uint16)


def encode_png(image: NDArray[Any]) -> bytes:
    """(height, width) uint8 or uint16 grey, or (height, width, 3) uint8 RGB, as a PNG file."""
    return _encoded(image, ".png")


def encode_jpeg(image: NDArray[np.uint8], quality: int = 90) -> bytes:
    """(height, width, 3) RGB as a JPEG file."""
    return _encoded(image, ".jpg", quality)


def _encoded(image: NDArray[Any], suffix: str, quality: int = 90) -> bytes:
    import cv2

    done, data = cv2.imencode(
        suffix, image[..., ::-1] if image.ndim == 3 else image, (cv2.IMWRITE_JPEG_QUALITY, quality)
    )
    assert done, f"OpenCV could not encode {suffix}"
    return bytes(data.tobytes())


def _png_header(data: bytes) -> tuple[int, int, int, int]:
    """Width, height, bits a sample, colour type."""
    if len(data) < 33 or data[12:16] != b"IHDR":
        raise InputError("the PNG file has no header")
    width, height, bits, kind = struct.unpack_from(">IIBB", data, 16)
    _check_sides(width, height)
    return width, height, bits, kind


def _check_png(data: bytes) -> None:
    """Every chunk of a PNG with its CRC, up to the end chunk."""
    at, view = len(_PNG), memoryview(data)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            break
        if zlib.crc32(view[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            raise InputError("the PNG file is damaged: a checksum is wrong")
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end + 4
    raise InputError("the PNG file is cut off: its end is missing")


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Width and height from the frame header (SOF) of a JPEG."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            _check_sides(width, height)
            return width, height
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]
    raise InputError("the JPEG file has no frame header")


def _check_sides(width: int, height: int) -> None:
    if not (0 < width <= MAX_IMAGE_SIDE and 0 < height <= MAX_IMAGE_SIDE and width * height <= MAX_PIXELS):
        raise InputError(
            f"the picture is {width}x{height} pixels; expected sides between 1 and {MAX_IMAGE_SIDE} "
            f"and at most {MAX_PIXELS} pixels"
        )
