"""The messages of a recording, encoded and decoded: Foxglove's in protobuf, depth as a ROS 2 image in CDR.

Decoders raise InputError, DecodeError (protobuf) or struct.error on broken bytes; formats.recording makes them one
sentence that says where.
"""

from __future__ import annotations

import struct
from typing import Any, Literal

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from openvox.core.errors import InputError
from openvox.core.types import DepthImage, IdImage, Intrinsics, Pose
from openvox.formats.mcap_io import Topic

WORLD, DEPTH_CAMERA, COLOR_CAMERA = "world", "camera_depth", "camera_color"

_SEPARATOR = "=" * 80 + "\nMSG: "
_IMAGE_DEFINITION = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    f"uint8[] data\n{_SEPARATOR}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_SEPARATOR}builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


def descriptor_bytes(message: Any) -> bytes:
    """The schema of a protobuf message class as MCAP wants it: a FileDescriptorSet, dependencies first."""
    out, seen = FileDescriptorSet(), set[str]()

    def add(file: FileDescriptor) -> None:
        if file.name in seen:
            return
        seen.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(out.file.add())

    add(message.DESCRIPTOR.file)
    return out.SerializeToString(deterministic=True)


def protobuf_topic(name: str, message: Any) -> Topic:
    """A topic of protobuf messages of that class."""
    return Topic(name, "protobuf", message.DESCRIPTOR.full_name, "protobuf", descriptor_bytes(message))


COLOR = protobuf_topic("/camera/color", CompressedImage)
DEPTH = Topic("/camera/depth", "cdr", "sensor_msgs/msg/Image", "ros2msg", _IMAGE_DEFINITION.encode())
COLOR_CALIBRATION = protobuf_topic("/camera/color/calibration", CameraCalibration)
DEPTH_CALIBRATION = protobuf_topic("/camera/depth/calibration", CameraCalibration)
TRANSFORMS = protobuf_topic("/tf", FrameTransforms)
TRUTH_INSTANCES = protobuf_topic("/truth/instances", RawImage)
TRUTH_CATEGORIES = protobuf_topic("/truth/categories", RawImage)
TOPICS = (DEPTH_CALIBRATION, COLOR_CALIBRATION, TRANSFORMS, DEPTH, COLOR, TRUTH_INSTANCES, TRUTH_CATEGORIES)


def encode_depth(stamp_ns: int, depth: DepthImage) -> bytes:
    """sensor_msgs/msg/Image 16UC1, little-endian CDR. depth: millimetres."""
    height, width = depth.shape
    head = bytearray(struct.pack("<4BiI", 0, 1, 0, 0, *divmod(stamp_ns, 10**9)))
    _put_text(head, DEPTH_CAMERA)
    _align(head)
    head += struct.pack("<II", height, width)
    _put_text(head, "16UC1")
    head.append(0)
    _align(head)
    head += struct.pack("<II", 2 * width, 2 * width * height)
    return bytes(head) + np.ascontiguousarray(depth, "<u2").tobytes()


def decode_depth(data: memoryview) -> DepthImage:
    """Millimetres, copied once out of the message."""
    if bytes(data[:2]) != b"\0\1":
        raise InputError(f"the CDR header is {bytes(data[:4]).hex()}; expected little-endian CDR (00010000)")
    _, at = _get_text(data, 12)
    height, width = struct.unpack_from("<II", data, _aligned(at))
    encoding, at = _get_text(data, _aligned(at) + 8)
    big_endian, at = data[at], _aligned(at + 1)
    step, size = struct.unpack_from("<II", data, at)
    if encoding != "16UC1" or big_endian:
        raise InputError(f"depth is {encoding!r}{' big-endian' * bool(big_endian)}; expected little-endian 16UC1")
    if step != 2 * width or size != step * height or size != len(data) - at - 8:
        raise InputError(f"depth of {width}x{height} pixels has rows of {step} and {size} bytes in {len(data)}")
    return np.frombuffer(data, "<u2", width * height, at + 8).reshape(height, width).astype(np.uint16)


def encode_color(stamp_ns: int, data: bytes, color_format: str) -> bytes:
    """foxglove.CompressedImage of a JPEG or PNG file's bytes."""
    message = CompressedImage(frame_id=COLOR_CAMERA, data=data, format=color_format)
    return _serialized(message, stamp_ns)


def decode_color(data: memoryview) -> tuple[bytes, Literal["jpeg", "png"]]:
    """The picture's file and its format."""
    message = CompressedImage.FromString(bytes(data))
    if message.format not in ("jpeg", "png"):
        raise InputError(f"colour is {message.format!r}; expected jpeg or png")
    return message.data, "jpeg" if message.format == "jpeg" else "png"


def encode_calibration(stamp_ns: int, camera: Intrinsics, frame_id: str) -> bytes:
    """foxglove.CameraCalibration of an undistorted pinhole camera."""
    k = (camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0)
    message = CameraCalibration(
        frame_id=frame_id,
        width=camera.width,
        height=camera.height,
        K=k,
        R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        P=(*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0),
    )
    return _serialized(message, stamp_ns)


def decode_calibration(data: memoryview) -> Intrinsics:
    """The camera; one with distortion is refused."""
    message = CameraCalibration.FromString(bytes(data))
    if len(message.K) != 9 or any(message.D):
        raise InputError(
            f"calibration has {len(message.K)} numbers in K and distortion {list(message.D)}; "
            "expected 9 and none: undistort the pictures first"
        )
    fx, _, cx, _, fy, cy, *_ = message.K
    return Intrinsics(message.width, message.height, fx, fy, cx, cy)


def encode_transforms(stamp_ns: int, world_from_depth: Pose, depth_from_color: Pose) -> bytes:
    """foxglove.FrameTransforms: world <- camera_depth <- camera_color."""
    message = FrameTransforms()
    for parent, child, pose in (
        (WORLD, DEPTH_CAMERA, world_from_depth),
        (DEPTH_CAMERA, COLOR_CAMERA, depth_from_color),
    ):
        transform = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
        transform.timestamp.FromNanoseconds(stamp_ns)
        for part, names, values in (
            (transform.rotation, "xyzw", pose.quaternion),
            (transform.translation, "xyz", pose.translation),
        ):
            for name, value in zip(names, values, strict=True):
                setattr(part, name, value)
    return message.SerializeToString(deterministic=True)


def decode_transforms(data: memoryview) -> tuple[Pose, Pose]:
    """world_from_depth and depth_from_color (identity if it is not there)."""
    poses: dict[tuple[str, str], Pose] = {}
    for transform in FrameTransforms.FromString(bytes(data)).transforms:
        r, t = transform.rotation, transform.translation
        pose = Pose((r.x, r.y, r.z, r.w), (t.x, t.y, t.z))
        poses[transform.parent_frame_id, transform.child_frame_id] = pose
    if (WORLD, DEPTH_CAMERA) not in poses:
        raise InputError(f"there is no transform of {DEPTH_CAMERA} in {WORLD}")
    return poses[WORLD, DEPTH_CAMERA], poses.get((DEPTH_CAMERA, COLOR_CAMERA), Pose.identity())


def encode_ids(stamp_ns: int, ids: IdImage) -> bytes:
    """foxglove.RawImage mono16 of ids in colour pixels."""
    height, width = ids.shape
    data = np.ascontiguousarray(ids, "<u2").tobytes()
    message = RawImage(frame_id=COLOR_CAMERA, width=width, height=height, encoding="mono16", step=2 * width, data=data)
    return _serialized(message, stamp_ns)


def decode_ids(data: memoryview) -> IdImage:
    """Ids in colour pixels."""
    message = RawImage.FromString(bytes(data))
    if message.encoding != "mono16" or message.step != 2 * message.width:
        raise InputError(f"ids are {message.encoding!r} with rows of {message.step} bytes; expected dense mono16")
    if len(message.data) != message.step * message.height:
        raise InputError(f"ids of {message.width}x{message.height} pixels come in {len(message.data)} bytes")
    return np.frombuffer(message.data, "<u2").reshape(message.height, message.width).astype(np.uint16)


def _serialized(message: Any, stamp_ns: int) -> bytes:
    message.timestamp.FromNanoseconds(stamp_ns)
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def _aligned(at: int) -> int:
    """The next place for four bytes: CDR counts from behind its header of four, so plain multiples of four."""
    return -(-at // 4) * 4


def _align(buffer: bytearray) -> None:
    buffer += bytes(_aligned(len(buffer)) - len(buffer))


def _put_text(buffer: bytearray, text: str) -> None:
    _align(buffer)
    buffer += struct.pack("<I", len(text) + 1) + text.encode() + b"\0"


def _get_text(data: memoryview, at: int) -> tuple[str, int]:
    """A text and where it ends."""
    (length,) = struct.unpack_from("<I", data, _aligned(at))
    end = _aligned(at) + 4 + length
    if not 0 < length <= 256 or end > len(data):
        raise InputError(f"a text of {length} bytes in a message of {len(data)}")
    return bytes(data[end - length : end - 1]).decode("ascii", "replace"), end
