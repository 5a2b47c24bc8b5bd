"""The messages of a perception file: our own in protobuf, whose descriptor is made here and travels in the file.

Every message of ours begins alike: timestamp, frame_id (the colour camera's), and the digests of the frame and of the
stage. Decoders raise InputError or protobuf's DecodeError on broken bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import Mask
from openvox.formats.detections import Box
from openvox.formats.schemas import COLOR_CAMERA, protobuf_topic

_TYPE = descriptor_pb2.FieldDescriptorProto
_TIMESTAMP = ".google.protobuf.Timestamp"
_HEAD = (
    ("timestamp", _TIMESTAMP, False),
    ("frame_id", _TYPE.TYPE_STRING, False),
    ("frame_digest", _TYPE.TYPE_STRING, False),
    ("stage_digest", _TYPE.TYPE_STRING, False),
)
_CORNERS = ("x0", "y0", "x1", "y1")
_MESSAGES: dict[str, tuple[tuple[str, int | str, bool], ...]] = {
    "Detection": (
        *((name, _TYPE.TYPE_DOUBLE, False) for name in _CORNERS),
        ("score", _TYPE.TYPE_DOUBLE, False),
        ("label", _TYPE.TYPE_STRING, False),
    ),
    "Detections": (*_HEAD, ("detections", ".openvox.Detection", True)),
    "Alternative": (
        ("label", _TYPE.TYPE_STRING, False),
        ("caption", _TYPE.TYPE_STRING, False),
        ("score", _TYPE.TYPE_DOUBLE, False),
    ),
    "Mask": (
        *((name, _TYPE.TYPE_UINT32, False) for name in _CORNERS),
        ("bits", _TYPE.TYPE_BYTES, False),
        ("score", _TYPE.TYPE_DOUBLE, False),
        ("label", _TYPE.TYPE_STRING, False),
        ("caption", _TYPE.TYPE_STRING, False),
        ("caption_score", _TYPE.TYPE_DOUBLE, False),
        ("named", _TYPE.TYPE_BOOL, False),
        ("kind", _TYPE.TYPE_STRING, False),
        ("alternatives", ".openvox.Alternative", True),
    ),
    "Masks": (
        *_HEAD,
        ("width", _TYPE.TYPE_UINT32, False),
        ("height", _TYPE.TYPE_UINT32, False),
        ("masks", ".openvox.Mask", True),
    ),
    "Embeddings": (
        *_HEAD,
        ("encoder", _TYPE.TYPE_STRING, False),
        ("dimensions", _TYPE.TYPE_UINT32, False),
        ("vectors", _TYPE.TYPE_BYTES, False),
        ("vector_of_mask", _TYPE.TYPE_UINT32, True),
    ),
}
_FONT_SIZE = 12.0
MAX_NUMBERS = 1 << 26
"""In the vectors of all masks of a frame; equal ones are stored once, so that few bytes may claim more."""
_COLORS = {"object": (0.1, 0.8, 0.3), "region": (0.2, 0.6, 1.0), "support": (1.0, 0.7, 0.1)}


def _classes() -> dict[str, Any]:
    """A class for each message. The pool is our own: the default one would refuse another version of the file."""
    file = descriptor_pb2.FileDescriptorProto(
        name="openvox/Perception.proto", package="openvox", syntax="proto3", dependency=[timestamp_pb2.DESCRIPTOR.name]
    )
    for name, fields in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for number, (field_name, kind, repeated) in enumerate(fields, 1):
            label = _TYPE.LABEL_REPEATED if repeated else _TYPE.LABEL_OPTIONAL
            field = message.field.add(name=field_name, number=number, label=label)
            if isinstance(kind, str):
                field.type, field.type_name = _TYPE.TYPE_MESSAGE, kind
            else:
                field.type = kind  # type: ignore[assignment]
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"openvox.{name}")) for name in _MESSAGES}


_CLASS = _classes()
DETECTIONS = protobuf_topic("/perception/detections", _CLASS["Detections"])
MASKS = protobuf_topic("/perception/masks", _CLASS["Masks"])
EMBEDDINGS = protobuf_topic("/perception/embeddings", _CLASS["Embeddings"])
ANNOTATIONS = protobuf_topic("/perception/annotations", ImageAnnotations)
TOPICS = (DETECTIONS, MASKS, EMBEDDINGS, ANNOTATIONS)


def encode_detections(stamp_ns: int, digests: tuple[str, str], boxes: Sequence[Box]) -> bytes:
    """openvox.Detections. digests: of the frame and of the stage."""
    message = _headed("Detections", stamp_ns, digests)
    for box in boxes:
        message.detections.add(**dict(zip(_CORNERS, box.corners, strict=True)), score=box.score, label=box.label)
    return _serialized(message)


def decode_detections(data: memoryview) -> tuple[tuple[str, str], tuple[Box, ...]]:
    """The digests and the boxes."""
    message = _CLASS["Detections"].FromString(bytes(data))
    boxes = (Box((d.x0, d.y0, d.x1, d.y1), d.score, d.label) for d in message.detections)
    return (message.frame_digest, message.stage_digest), tuple(boxes)


def encode_masks(stamp_ns: int, digests: tuple[str, str], size: tuple[int, int], masks: Sequence[Mask]) -> bytes:
    """openvox.Masks. size: (height, width) of the colour image."""
    message = _headed("Masks", stamp_ns, digests)
    message.height, message.width = size
    for mask in masks:
        added = message.masks.add(
            **dict(zip(_CORNERS, mask.box, strict=True)),
            bits=mask.bits.tobytes(),
            score=mask.score,
            label=mask.label,
            caption=mask.caption,
            caption_score=mask.caption_score,
            named=mask.named,
            kind=mask.kind,
        )
        for label, caption, score in mask.alternatives:
            added.alternatives.add(label=label, caption=caption, score=score)
    return _serialized(message)


def decode_masks(data: memoryview) -> tuple[tuple[str, str], tuple[int, int], list[dict[str, Any]]]:
    """The digests, (height, width) of the colour image, and the fields of each core.Mask, without its embedding."""
    message = _CLASS["Masks"].FromString(bytes(data))
    masks = [
        {
            "box": (m.x0, m.y0, m.x1, m.y1),
            "bits": np.frombuffer(m.bits, np.uint8),
            "score": m.score,
            "label": m.label,
            "caption": m.caption,
            "caption_score": m.caption_score,
            "named": m.named,
            "kind": m.kind,
            "alternatives": tuple((a.label, a.caption, a.score) for a in m.alternatives),
        }
        for m in message.masks
    ]
    for number, mask in enumerate(masks):
        if mask["box"][2] > message.width or mask["box"][3] > message.height:
            raise InputError(f"mask {number} reaches out of the picture of {message.width}x{message.height} pixels")
    return (message.frame_digest, message.stage_digest), (message.height, message.width), masks


def encode_embeddings(stamp_ns: int, digests: tuple[str, str], encoder: str, vectors: NDArray[np.float32]) -> bytes:
    """openvox.Embeddings of (masks, dimensions) vectors, equal ones once: float32, little-endian, row by row."""
    message = _headed("Embeddings", stamp_ns, digests)
    message.encoder, message.dimensions = encoder, vectors.shape[1]
    rows = [row.tobytes() for row in np.ascontiguousarray(vectors, "<f4")]
    place = {row: i for i, row in enumerate(dict.fromkeys(rows))}
    message.vectors = b"".join(place)
    message.vector_of_mask.extend(place[row] for row in rows)
    return _serialized(message)


def decode_embeddings(data: memoryview) -> tuple[tuple[str, str], NDArray[np.float32]]:
    """The digests and (masks, dimensions) vectors."""
    message = _CLASS["Embeddings"].FromString(bytes(data))
    dimensions = message.dimensions
    if not dimensions or len(message.vectors) % (4 * dimensions):
        raise InputError(f"{len(message.vectors)} bytes are no vectors of {dimensions} float32 numbers")
    vectors = np.frombuffer(message.vectors, "<f4").reshape(-1, dimensions)
    rows = np.array(message.vector_of_mask, np.int64)
    if len(rows) * dimensions > MAX_NUMBERS:
        raise InputError(f"{len(rows)} masks with vectors of {dimensions} numbers are too many for a frame")
    if len(rows) and int(rows.max()) >= len(vectors):
        raise InputError(f"a mask has vector {int(rows.max())} of {len(vectors)}")
    return (message.frame_digest, message.stage_digest), vectors.astype(np.float32)[rows]


def encode_annotations(stamp_ns: int, masks: Iterable[Mask]) -> bytes:
    """foxglove.ImageAnnotations: each mask's box in the colour of its kind, its number and caption above it."""
    message = ImageAnnotations()
    message.timestamp.FromNanoseconds(stamp_ns)
    for number, mask in enumerate(masks):
        x0, y0, x1, y1 = mask.box
        red, green, blue = _COLORS[mask.kind]
        outline = message.points.add(type=PointsAnnotation.LINE_LOOP, thickness=1.0)
        outline.timestamp.FromNanoseconds(stamp_ns)
        for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)):
            outline.points.add(x=x, y=y)
        text = message.texts.add(text=f"{number} {mask.caption}", font_size=_FONT_SIZE)
        text.timestamp.FromNanoseconds(stamp_ns)
        text.position.x, text.position.y = x0, y0
        for color in (outline.outline_color, text.text_color):
            color.r, color.g, color.b, color.a = red, green, blue, 1.0
    return _serialized(message)


def _headed(name: str, stamp_ns: int, digests: tuple[str, str]) -> Any:
    message = _CLASS[name](frame_id=COLOR_CAMERA)
    message.frame_digest, message.stage_digest = digests
    message.timestamp.FromNanoseconds(stamp_ns)
    return message


def _serialized(message: Any) -> bytes:
    data: bytes = message.SerializeToString(deterministic=True)
    return data
