"""What a robot's log is made of, whoever wrote it: pictures, calibrations and transforms on topics."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from openvox.core.types import Pose

TopicKind = Literal["image", "calibration", "transforms", "pose"]


@dataclass(frozen=True, eq=False, slots=True)
class Picture:
    """An image as it was logged. `encoding`: rgb8, 16UC1, ..., or "compressed" (a JPEG or PNG file), or
    "compressedDepth" (ROS: a header of twelve bytes, then a PNG)."""

    stamp_ns: int
    frame_id: str
    encoding: str
    data: bytes | memoryview
    width: int = 0
    height: int = 0
    step: int = 0
    """Bytes from row to row; width, height and step are those of pictures that are not compressed."""
    big_endian: bool = False


@dataclass(frozen=True, slots=True)
class Calibration:
    """Of a camera: frame, size, K (9 numbers), distortion with its model, P (12 numbers, for rectified pictures)."""

    frame_id: str
    width: int
    height: int
    k: tuple[float, ...]
    d: tuple[float, ...]
    model: str
    p: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Transform:
    """`pose` takes coordinates of `child` to those of `parent`; names without a leading slash."""

    stamp_ns: int
    parent: str
    child: str
    pose: Pose
    static: bool = False


Item = Picture | Calibration | tuple[Transform, ...]


@dataclass(frozen=True, eq=False)
class Log:
    """An opened log. `read`: (time of logging in ns, topic, item) of some topics, in the order of logging."""

    path: Path | str
    """A file, or a server's address."""
    kind: str
    topics: Mapping[str, TopicKind]
    read: Callable[[Collection[str]], Iterator[tuple[int, str, Item]]]
