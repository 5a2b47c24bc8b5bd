"""The messages of a trace, encoded and decoded."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import Event, Step, VoxelChanges
from openvox.formats.mcap_io import Topic
from openvox.formats.schemas import protobuf_topic

_TYPE = descriptor_pb2.FieldDescriptorProto
_COLUMNS = ("new_index", "voxel", "fragment", "count")
_EVENT = re.compile(r"([a-z]+) instance (\d+)(?: with (\d+(?:, \d+)*))?: (.*)", re.DOTALL)

_INTEGER = {"type": "integer"}
_CANDIDATE = dict.fromkeys(("instance", "overlap", "s_geo", "s_fea", "a"), _INTEGER)
_NUMBERS = (
    *("mask", "instance", "fragment", "voxels", "abstained"),
    *("s_geo", "s_fea", "a", "threshold", "visibility", "credibility"),
)
_DECISION = {
    **dict.fromkeys(_NUMBERS, _INTEGER),
    **{name: {"type": "string"} for name in ("by", "caption", "kind")},
    "held": {"type": "array", "items": _INTEGER},
    "candidates": {"type": "array", "items": {"type": "object", "properties": _CANDIDATE}},
}
_SCHEMA = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "openvox.Decisions",
    "description": "Scores in parts of 2**20, credibility in parts of 2**12.",
    "type": "object",
    "properties": {
        "frame": _INTEGER,
        "looked": {"type": "boolean"},
        "voxels": _INTEGER,
        "regrouped": {"type": "array", "items": {"type": "array", "items": _INTEGER}},
        "decisions": {"type": "array", "items": {"type": "object", "properties": _DECISION}},
    },
}


@dataclass(frozen=True, eq=False)
class VotesChanged:
    """Which counts one frame changed; the arrays are those of core.types.VoxelChanges."""

    first_new: int
    new_index: NDArray[np.int32]
    voxel: NDArray[np.int32]
    fragment: NDArray[np.int32]
    count: NDArray[np.int32]


def _changes_class() -> Any:
    file = descriptor_pb2.FileDescriptorProto(
        name="openvox/Trace.proto", package="openvox", syntax="proto3", dependency=[timestamp_pb2.DESCRIPTOR.name]
    )
    message = file.message_type.add(name="VoxelChanges")
    fields = (("timestamp", None), ("first_new", _TYPE.TYPE_UINT32), *((name, _TYPE.TYPE_BYTES) for name in _COLUMNS))
    for number, (name, kind) in enumerate(fields, 1):
        field = message.field.add(name=name, number=number, label=_TYPE.LABEL_OPTIONAL)
        if kind is None:
            field.type, field.type_name = _TYPE.TYPE_MESSAGE, ".google.protobuf.Timestamp"
        else:
            field.type = kind
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("openvox.VoxelChanges"))


_Changes = _changes_class()
DECISIONS = Topic("/mapper/decisions", "json", "openvox.Decisions", "jsonschema", json.dumps(_SCHEMA).encode())
EVENTS = protobuf_topic("/mapper/events", Log)
VOXELS = protobuf_topic("/mapper/voxels", _Changes)


def encode_decisions(step: Step, before: Mapping[int, int]) -> bytes:
    """The frame's decisions as JSON, each with its mask's caption and kind for people, and what became of fragments.

    before: instance of every fragment before the frame; `regrouped` lists (fragment, instance) where that changed."""
    rows = []
    for decision in step.decisions:
        mask = step.masks[decision.mask]
        rows.append({**asdict(decision), "caption": mask.caption, "kind": mask.kind})
    regrouped = [[f, step.instance_of[f]] for f in sorted(step.instance_of) if step.instance_of[f] != before.get(f)]
    content = {
        "frame": step.frame.index,
        "looked": step.looked,
        "voxels": step.voxels,
        "regrouped": regrouped,
        "decisions": rows,
    }
    return json.dumps(content, separators=(",", ":")).encode()


def encode_event(stamp_ns: int, event: Event) -> bytes:
    """foxglove.Log: what happened to which instance, and why."""
    message = Log(level=Log.INFO, name="mapper")
    message.timestamp.FromNanoseconds(stamp_ns)
    others = f" with {', '.join(str(other) for other in event.others)}" if event.others else ""
    message.message = f"{event.kind} instance {event.instance}{others}: {event.text}"
    return bytes(message.SerializeToString(deterministic=True))


def decode_event(frame: int, data: memoryview) -> Event:
    """The event. Raises ValueError or DecodeError."""
    found = _EVENT.fullmatch(Log.FromString(bytes(data)).message)
    if found is None:
        raise InputError(f"frame {frame}: an event of the trace is not worded as expected; replay again")
    kind, instance, others, text = found.groups()
    return Event(frame, kind, int(instance), tuple(int(n) for n in (others or "").split(", ") if n), text)  # type: ignore[arg-type]


def encode_changes(stamp_ns: int, changes: VoxelChanges) -> bytes:
    """openvox.VoxelChanges: columns of little-endian int32."""
    message = _Changes(first_new=changes.first_new)
    message.timestamp.FromNanoseconds(stamp_ns)
    for name in _COLUMNS:
        setattr(message, name, np.ascontiguousarray(getattr(changes, name), "<i4").tobytes())
    return bytes(message.SerializeToString(deterministic=True))


def decode_changes(data: memoryview) -> VotesChanged:
    """The columns. Raises ValueError where they are not of equal length, DecodeError on broken bytes."""
    message = _Changes.FromString(bytes(data))
    new_index, voxel, fragment, count = (np.frombuffer(getattr(message, name), "<i4") for name in _COLUMNS)
    if not len(voxel) == len(fragment) == len(count) or len(new_index) % 3:
        raise ValueError("columns of unequal length")
    return VotesChanged(message.first_new, new_index.reshape(-1, 3), voxel, fragment, count)
