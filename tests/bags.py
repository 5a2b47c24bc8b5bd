"""ROS bags for tests, written by the rosbags library: tiny frames seen by a camera on a robot that drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from openvox.core.types import Frame, Intrinsics, Pose
from openvox.sources.transforms import compose, inverse

Message = tuple[str, int, Any]
"""Topic, time of logging in nanoseconds, message."""
OPTICAL = "camera_color_optical_frame"
COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
MOUNT = Pose((0.5, -0.5, 0.5, -0.5), (0.1, 0.0, 0.4))
"""base_link <- camera: the optical axis ahead, and a lever arm."""


class Messages:
    """Makes messages for ROS 2 (or ROS 1) out of frames."""

    def __init__(self, ros1: bool = False, old_tf: bool = False) -> None:
        self.ros1, self.tf_type = ros1, "tf/msg/tfMessage" if old_tf else "tf2_msgs/msg/TFMessage"
        self.store: Typestore = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        if ros1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, self.tf_type))

    def make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        seconds, rest = divmod(stamp_ns, 10**9)
        time = self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        more = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **more)

    def image(self, stamp_ns: int, image: NDArray[Any], encoding: str, frame: str = OPTICAL, big: bool = False) -> Any:
        data = image.astype(image.dtype.newbyteorder(">" if big else "<")).tobytes()
        height, width = image.shape[:2]
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(stamp_ns, frame),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=int(big),
            step=len(data) // height,
            data=np.frombuffer(data, np.uint8),
        )

    def compressed(self, stamp_ns: int, data: bytes, text: str, frame: str = OPTICAL) -> Any:
        header, content = self.header(stamp_ns, frame), np.frombuffer(data, np.uint8)
        return self.make("sensor_msgs/msg/CompressedImage", header=header, format=text, data=content)

    def info(self, stamp_ns: int, camera: Intrinsics, d: tuple[float, ...] = (0.0,) * 5, frame: str = OPTICAL) -> Any:
        k = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1.0])
        p = np.array([*k[:3], 0, *k[3:6], 0, *k[6:], 0.0])
        numbers = {"d": np.array(d), "k": k, "r": np.eye(3).ravel(), "p": p}
        if self.ros1:
            numbers = {name.upper(): value for name, value in numbers.items()}
        roi = self.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, frame),
            height=camera.height,
            width=camera.width,
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=roi,
            **numbers,
        )

    def pose(self, pose: Pose) -> Any:
        point = self.make("geometry_msgs/msg/Point", **dict(zip("xyz", pose.translation, strict=True)))
        turn = self.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", pose.quaternion, strict=True)))
        return self.make("geometry_msgs/msg/Pose", position=point, orientation=turn)

    def tf(self, stamp_ns: int, parent: str, child: str, pose: Pose) -> Any:
        t = self.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", pose.translation, strict=True)))
        q = self.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", pose.quaternion, strict=True)))
        transform = self.make("geometry_msgs/msg/Transform", translation=t, rotation=q)
        one = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            transform=transform,
        )
        return self.make(self.tf_type, transforms=[one])

    def odometry(self, stamp_ns: int, parent: str, child: str, pose: Pose) -> Any:
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(pose), covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def pose_stamped(self, stamp_ns: int, parent: str, pose: Pose) -> Any:
        header = self.header(stamp_ns, parent)
        return self.make("geometry_msgs/msg/PoseStamped", header=header, pose=self.pose(pose))


def rgb_of(frame: Frame) -> NDArray[np.uint8]:
    """The frame's colour, (height, width, 3)."""
    image = cv2.imdecode(np.frombuffer(frame.color, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.ascontiguousarray(image[..., ::-1])


def robot(make: Messages, frames: list[Frame], mount: Pose = MOUNT) -> Iterator[Message]:
    """map <- odom <- base_link <- camera: transforms every 50 ms, the pictures of each frame 5 ms after their stamp."""
    begin = frames[0].stamp_ns
    yield "/tf_static", begin + 40_000_000, make.tf(0, "base_link", OPTICAL, mount)
    odom = Pose((0.0, 0.0, 0.0, 1.0), (5.0, -2.0, 0.0))
    for frame in frames:
        base = compose(inverse(odom), compose(frame.world_from_depth, inverse(mount)))
        for parent, child, pose in (("map", "odom", odom), ("odom", "base_link", base)):
            yield "/tf", frame.stamp_ns + 9_000_000, make.tf(frame.stamp_ns, parent, child, pose)


def pictures(make: Messages, frames: list[Frame]) -> Iterator[Message]:
    """Colour as JPEG, depth as 16UC1, and the calibration of both."""
    for frame in frames:
        stamp, logged = frame.stamp_ns, frame.stamp_ns + 5_000_000
        yield f"{COLOR}/compressed", logged, make.compressed(stamp, frame.color, "rgb8; jpeg compressed bgr8")
        yield DEPTH, logged, make.image(stamp, frame.depth, "16UC1")
        for topic, camera in ((COLOR, frame.rig.color), (DEPTH, frame.rig.depth)):
            yield topic.replace("image_raw", "camera_info"), logged, make.info(stamp, camera)


def write_bag(path: Path, make: Messages, messages: list[Message], storage: str = "mcap") -> Path:
    """A bag in the order of logging; ROS 1 if `make` is. Returns the path."""
    writer: Any
    if make.ros1:
        writer, encode = Writer1(path), make.store.serialize_ros1
    else:
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer, encode = Writer2(path, version=9, storage_plugin=plugin), make.store.serialize_cdr
    encoded: Callable[..., Any] = encode
    with writer:
        topics: dict[str, Any] = {}
        for topic, time, message in sorted(messages, key=lambda one: one[1]):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, message.__msgtype__, typestore=make.store)
            writer.write(topics[topic], time, encoded(message, message.__msgtype__))
    return path
