"""A frame as the messages of a recording, both ways."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

from google.protobuf.message import DecodeError

from openvox.core.errors import InputError
from openvox.core.types import Frame, Rig
from openvox.formats import schemas
from openvox.formats.images import image_size
from openvox.formats.mcap_io import Message, Topic

NEEDED = (schemas.DEPTH, schemas.DEPTH_CALIBRATION, schemas.TRANSFORMS)
"""Topics that every frame must have."""
_NO_COLOR: tuple[bytes, Literal[""]] = (b"", "")


def encode_frame(frame: Frame) -> Iterator[tuple[Topic, bytes]]:
    """The messages of a frame, in the order of the file: small ones first."""
    stamp, rig = frame.stamp_ns, frame.rig
    yield schemas.DEPTH_CALIBRATION, schemas.encode_calibration(stamp, rig.depth, schemas.DEPTH_CAMERA)
    yield schemas.COLOR_CALIBRATION, schemas.encode_calibration(stamp, rig.color, schemas.COLOR_CAMERA)
    yield schemas.TRANSFORMS, schemas.encode_transforms(stamp, frame.world_from_depth, rig.depth_from_color)
    yield schemas.DEPTH, schemas.encode_depth(stamp, frame.depth)
    if frame.color:
        yield schemas.COLOR, schemas.encode_color(stamp, frame.color, frame.color_format)
    if frame.truth_instances is not None:
        yield schemas.TRUTH_INSTANCES, schemas.encode_ids(stamp, frame.truth_instances)
    if frame.truth_categories is not None:
        yield schemas.TRUTH_CATEGORIES, schemas.encode_ids(stamp, frame.truth_categories)


def decode_frame(path: Path, messages: Mapping[str, Message], rig: Rig | None, truth: bool) -> Frame:
    """One frame of its messages. rig: the last frame's, kept if it is equal."""
    head = next(iter(messages.values()))
    where = f"{path}, frame {head.sequence}"

    def decoded(topic: Topic, decode: Any) -> Any:
        if topic.name not in messages:
            return None
        try:
            return decode(messages[topic.name].data)
        except (InputError, DecodeError, struct.error, IndexError) as error:
            raise InputError(f"{where}, {topic.name}: {error}") from error

    for topic in NEEDED:
        if topic.name not in messages:
            raise InputError(f"{where}: there is no message on {topic.name}")
    world_from_depth, depth_from_color = decoded(schemas.TRANSFORMS, schemas.decode_transforms)
    depth_camera = decoded(schemas.DEPTH_CALIBRATION, schemas.decode_calibration)
    color_camera = decoded(schemas.COLOR_CALIBRATION, schemas.decode_calibration)
    color, color_format = decoded(schemas.COLOR, schemas.decode_color) or _NO_COLOR
    if color and color_camera is None:
        raise InputError(f"{where}: colour has no message on {schemas.COLOR_CALIBRATION.name}")
    found = Rig(depth_camera, color_camera or depth_camera, depth_from_color)
    depth = decoded(schemas.DEPTH, schemas.decode_depth)
    instances, categories = (
        decoded(topic, schemas.decode_ids) if truth else None
        for topic in (schemas.TRUTH_INSTANCES, schemas.TRUTH_CATEGORIES)
    )
    try:
        frame = Frame(
            index=head.sequence,
            stamp_ns=head.log_time,
            world_from_depth=world_from_depth,
            rig=rig if rig == found else found,
            depth=depth,
            color=color,
            color_format=color_format,
            truth_instances=instances,
            truth_categories=categories,
        )
        check_color(frame)
    except InputError as error:
        raise InputError(f"{path}, {error}") from error
    return frame


def check_color(frame: Frame) -> None:
    """The colour file is of the format and the size that the frame says."""
    if not frame.color:
        return
    where = f"frame {frame.index}"
    try:
        found = image_size(frame.color)
    except InputError as error:
        raise InputError(f"{where}, colour: {error}") from error
    expected = (frame.color_format, frame.rig.color.width, frame.rig.color.height)
    if found != expected:
        raise InputError(
            f"{where}: colour is a {found[0]} of {found[1]}x{found[2]}; "
            f"its camera says {expected[0]} of {expected[1]}x{expected[2]}"
        )
