"""Binary glTF 2.0: coloured solids that Blender, a browser or a game engine opens.

One JSON chunk that describes and one binary chunk that holds numbers. glTF has y up and linear colours.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError

MAX_BYTES = (1 << 32) - 1
"""A file's length is written in 32 bits."""
_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Quaternion (x, y, z, w) that turns z up into y up."""
_FLOAT, _UINT = 5126, 5125
_POSITIONS, _INDICES = 34962, 34963


@dataclass(frozen=True, eq=False, slots=True)
class Solid:
    """A thing of its own: a node with a mesh of triangles in one colour."""

    name: str
    color: tuple[int, int, int]
    """Red, green, blue, 0 .. 255, sRGB."""
    origin: tuple[float, float, float]
    """Where its own zero lies, metres."""
    vertices: NDArray[np.float32]
    """(n, 3) metres from its origin, n > 0."""
    triangles: NDArray[np.uint32]
    """(m, 3) rows of vertices, counter-clockwise seen from outside."""
    about: Mapping[str, Any]
    """What a program may read of it: the node's extras."""


def glb(name: str, solids: Sequence[Solid], generator: str) -> bytes:
    """The bytes of a file with one node a solid below a root of that name. Raises InputError where it is too large."""
    root: dict[str, Any] = {"name": name, "rotation": _UP}
    if solids:
        root["children"] = [*range(1, len(solids) + 1)]
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": generator},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [root],
    }
    data = b""
    if solids:
        names = ("meshes", "materials", "accessors", "bufferViews")
        document |= {one: [] for one in names}
        data = b"".join(part for number, solid in enumerate(solids) for part in _add(document, number, solid))
        document["buffers"] = [{"byteLength": len(data)}]
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    chunks = [(b"JSON", text + b" " * (-len(text) % 4))] + ([(b"BIN\0", data)] if data else [])
    length = 12 + sum(8 + len(content) for _, content in chunks)
    if length > MAX_BYTES:
        raise InputError(f"the map is too large for one .glb: {length} bytes, of {MAX_BYTES}; export it as .ply")
    parts = [struct.pack("<4sII", b"glTF", 2, length)]
    parts += [struct.pack("<I4s", len(content), kind) + content for kind, content in chunks]
    return b"".join(parts)


def _add(document: dict[str, Any], number: int, solid: Solid) -> tuple[bytes, bytes]:
    """Describe a solid in the document; its two pieces of the binary chunk."""
    positions, indices = (
        np.ascontiguousarray(a) for a in (solid.vertices.astype("<f4"), solid.triangles.astype("<u4"))
    )
    views = document["bufferViews"]
    start = views[-1]["byteOffset"] + views[-1]["byteLength"] if views else 0
    for size, target in ((positions.nbytes, _POSITIONS), (indices.nbytes, _INDICES)):
        views.append({"buffer": 0, "byteOffset": start, "byteLength": size, "target": target})
        start += size
    low, high = positions.min(0).tolist(), positions.max(0).tolist()
    document["accessors"] += [
        {"bufferView": 2 * number, "componentType": _FLOAT, "count": len(positions), "type": "VEC3"}
        | {"min": low, "max": high},
        {"bufferView": 2 * number + 1, "componentType": _UINT, "count": indices.size, "type": "SCALAR"},
    ]
    color = [*(_linear(value) for value in solid.color), 1.0]
    surface = {"baseColorFactor": color, "metallicFactor": 0.0, "roughnessFactor": 1.0}
    document["materials"].append({"name": solid.name, "pbrMetallicRoughness": surface})
    piece = {"attributes": {"POSITION": 2 * number}, "indices": 2 * number + 1, "material": number}
    document["meshes"].append({"name": solid.name, "primitives": [piece]})
    node = {"name": solid.name, "mesh": number, "translation": list(solid.origin), "extras": dict(solid.about)}
    document["nodes"].append(node)
    return positions.tobytes(), indices.tobytes()


def _linear(value: int) -> float:
    """Of an sRGB value 0 .. 255, the light 0 .. 1."""
    share = value / 255
    return share / 12.92 if share <= 0.04045 else float(((share + 0.055) / 1.055) ** 2.4)
