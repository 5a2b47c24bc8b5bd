"""Binary PLY: points and meshes, little-endian; read as ScanNet and Replica have them, faces all of one size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError

MAX_HEADER = 1 << 16
MAX_CORNERS = 255
MAX_ROWS = 1 << 28
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    rows: int
    properties: tuple[tuple[str, ...], ...]
    """(name, type), or (name, type of the count, type) of a list."""


def read_ply(path: Path) -> dict[str, NDArray[Any]]:
    """Each element as a structured array; of a list property P, `P` has the items and `P_count` how many.

    Raises InputError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from None
    end = data[:MAX_HEADER].find(b"end_header\n")
    if not data.startswith(b"ply\n") or end < 0:
        raise InputError(f"{path} is no PLY file: it has no header")
    at = end + len(b"end_header\n")
    found: dict[str, NDArray[Any]] = {}
    for element in _elements(path, data[:end].decode("ascii", "replace")):
        try:
            found[element.name], size = _rows(path, element, data, at)
        except ValueError as error:  # two properties of one name, a list whose length is no number
            raise InputError(f"{path}: its element {element.name} cannot be read ({error})") from error
        at += size
    return found


def _elements(path: Path, header: str) -> list[_Element]:
    elements: list[_Element] = []
    for line in header.splitlines()[1:]:
        words = line.split()
        if words[:1] == ["format"] and words[1:2] != ["binary_little_endian"]:
            raise InputError(f"{path} is {' '.join(words[1:2])}; expected binary_little_endian")
        try:
            if words[:1] == ["element"]:
                elements.append(_Element(words[1], int(words[2]), ()))
            elif words[:1] == ["property"]:
                kind = words[2:4] if words[1] == "list" else words[1:2]
                one = (words[-1], *(_TYPES[name] for name in kind))
                last = elements.pop()
                elements.append(_Element(last.name, last.rows, (*last.properties, one)))
        except (IndexError, KeyError, ValueError) as error:
            raise InputError(f"{path}: its header has {line!r:.80}, which is not understood") from error
    return elements


def _rows(path: Path, element: _Element, data: bytes, at: int) -> tuple[NDArray[Any], int]:
    """The element's rows and their size in bytes; every list has as many items as the first one."""
    fields: list[tuple[Any, ...]] = []
    here = at
    for name, *kinds in element.properties:
        if len(kinds) == 2:
            raw = data[here : here + np.dtype(kinds[0]).itemsize]
            items = int(np.frombuffer(raw, kinds[0])[0]) if element.rows and raw else 0
            if not 0 <= items <= MAX_CORNERS:
                raise InputError(f"{path}: a {element.name} has a list of {items}; expected at most {MAX_CORNERS}")
            fields += [(f"{name}_count", kinds[0]), (name, kinds[1], (items,))]
        else:
            fields.append((name, kinds[0]))
        here = at + np.dtype(fields).itemsize
    dtype = np.dtype(fields)
    size = dtype.itemsize * element.rows
    if not 0 <= element.rows <= MAX_ROWS or at + size > len(data):
        raise InputError(
            f"{path}: {element.rows} rows of {element.name} do not fit in {len(data) - at} bytes; is it whole?"
        )
    rows = np.frombuffer(data, dtype, element.rows, at)
    for name in dtype.names or ():
        if name.endswith("_count") and element.rows and (rows[name] != rows[name][0]).any():
            raise InputError(
                f"{path}: lists of {element.name} have unequal lengths; expected triangles only, or quads only"
            )
    return rows, size


_NAMES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}


def ply(vertices: NDArray[np.void], triangles: NDArray[np.int32] | None, comment: str) -> bytes:
    """The bytes of a file. vertices: (n,) structured, of float32, uint8 and int32. triangles: (m, 3) rows of them."""
    fields = [f"property {_NAMES[vertices.dtype[name].str]} {name}" for name in vertices.dtype.names or ()]
    header = ["ply", "format binary_little_endian 1.0", f"comment {comment}", f"element vertex {len(vertices)}"]
    header += fields
    faces = b""
    if triangles is not None:
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
        rows = np.zeros(len(triangles), [("count", "u1"), ("corners", "<i4", 3)])
        rows["count"], rows["corners"] = 3, triangles
        faces = rows.tobytes()
    return "".join(f"{line}\n" for line in [*header, "end_header"]).encode("ascii") + vertices.tobytes() + faces
