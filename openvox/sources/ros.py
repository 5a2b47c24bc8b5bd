"""ROS bags through the rosbags library: ROS 2 in MCAP or SQLite (a folder or a file), ROS 1 `.bag`."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.core.types import Pose
from openvox.formats.mcap_io import MAGIC
from openvox.formats.robot_log import Calibration, Item, Log, Picture, TopicKind, Transform
from openvox.sources import log_frames
from openvox.sources.source import Options, Source

WANTED = ("metadata.yaml|*.mcap|*.db3|*.bag",)
_TF, _OLD_TF = "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"
KINDS: dict[str, TopicKind] = {
    "sensor_msgs/msg/Image": "image",
    "sensor_msgs/msg/CompressedImage": "image",
    "sensor_msgs/msg/CameraInfo": "calibration",
    _TF: "transforms",
    _OLD_TF: "transforms",
    "nav_msgs/msg/Odometry": "pose",
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose",
}
_FILES = (".mcap", ".db3", ".bag")


def missing(path: Path, options: Options) -> list[str]:
    """What is missing for it to be a bag."""
    if path.is_dir():
        return [] if (path / "metadata.yaml").is_file() else ["a bag"]
    if path.suffix not in _FILES or (path.suffix == ".mcap" and not _is_ros(path)):
        return ["a bag"]
    return []


def _is_ros(path: Path) -> bool:
    """True for an MCAP file whose header says so."""
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC) + 9 + 8)
    except OSError:
        return False
    return head.startswith(MAGIC) and head[len(MAGIC) + 9 :] == struct.pack("<I", 4) + b"ros2"


def read(path: Path, options: Options) -> Source:
    """Opens a bag. Raises InputError, also while iterating."""
    with _opened(path) as reader:
        topics = {one.topic: KINDS[one.msgtype] for one in reader.connections if one.msgtype in KINDS}
        distro = "ros1" if path.suffix == ".bag" else "ros2"
    log = Log(path, distro, dict(sorted(topics.items())), lambda names: _messages(path, names))
    return log_frames.read(log, options)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The bag's reader. Whatever the library raises on broken bytes is one sentence."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    try:
        with (Reader1 if path.suffix == ".bag" else Reader2)(path) as reader:
            yield reader
    except (InputError, GeneratorExit, KeyboardInterrupt):
        raise
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"{path} could not be read as a ROS bag ({text:.300}); is it whole? mcap recover, ros2 bag reindex and "
            "rosbag reindex mend what a crash cut off"
        ) from error


def _messages(path: Path, topics: Collection[str]) -> Iterator[tuple[int, str, Item]]:
    store = _typestore(path.suffix == ".bag")
    decode = store.deserialize_ros1 if path.suffix == ".bag" else store.deserialize_cdr
    with _opened(path) as reader:
        wanted = [one for one in reader.connections if one.topic in topics and one.msgtype in KINDS]
        if not wanted:
            return
        for connection, time, data in reader.messages(connections=wanted):
            kind = connection.msgtype if connection.msgtype != _OLD_TF else _TF
            yield time, connection.topic, _item(connection.topic, kind, decode(data, kind))


def cdr_item(topic: str, kind: str, data: bytes) -> Item:
    """A ROS 2 message of a file that is no bag."""
    return _item(topic, kind, _typestore(False).deserialize_cdr(data, kind))


@cache
def _typestore(ros1: bool) -> Any:
    """Only standard messages are read, so a bag's own definitions of others cannot be in the way."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if _TF not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
    return store


def _item(topic: str, kind: str, message: Any) -> Item:
    """A message as what it is to us."""
    if kind.endswith("/TFMessage"):
        static = topic.endswith("tf_static")
        return tuple(
            found for one in message.transforms for found in _transform(one, one.child_frame_id, one.transform, static)
        )
    if kind.endswith("/Odometry"):
        return _transform(message, message.child_frame_id, message.pose.pose)
    if kind.endswith("/PoseStamped"):
        return _transform(message, topic, message.pose)
    if kind.endswith("/PoseWithCovarianceStamped"):
        return _transform(message, topic, message.pose.pose)
    if kind.endswith("/CameraInfo"):
        numbers = (
            getattr(message, name) if hasattr(message, name) else getattr(message, name.upper()) for name in "kdp"
        )
        k, d, p = (tuple(float(value) for value in values) for values in numbers)
        frame = message.header.frame_id.lstrip("/")
        return Calibration(frame, message.width, message.height, k, d, message.distortion_model, p)
    return _picture(kind, message)


def _picture(kind: str, message: Any) -> Picture:
    stamp, frame = _stamp(message.header), message.header.frame_id.lstrip("/")
    data = message.data.data
    if kind.endswith("/CompressedImage"):
        encoding = "compressedDepth" if "compressedDepth" in message.format else "compressed"
        return Picture(stamp, frame, encoding, data)
    size = (message.width, message.height, message.step)
    return Picture(stamp, frame, message.encoding, data, *size, big_endian=bool(message.is_bigendian))


def _transform(message: Any, child: str, pose: Any, static: bool = False) -> tuple[Transform, ...]:
    """One; none for numbers that are no pose, as odometry sends before it has begun."""
    t = pose.translation if hasattr(pose, "translation") else pose.position
    q = pose.rotation if hasattr(pose, "rotation") else pose.orientation
    try:
        numbers = Pose((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))
    except InputError:
        return ()
    return (Transform(_stamp(message.header), message.header.frame_id.lstrip("/"), child.lstrip("/"), numbers, static),)


def _stamp(header: Any) -> int:
    stamp = header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
