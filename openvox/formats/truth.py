"""Ground truth in a folder: gt_points.npz, objects.json and queries.json if they are there; or a data set's mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.formats.npz import check_layout, read_arrays

MAX_TEXT_BYTES = 1 << 26
MAX_ID = 1 << 31
FAR = 1e6
"""Metres from the origin beyond which a point is an error of its file."""


@dataclass(frozen=True, slots=True)
class TrueObject:
    """One object of the truth."""

    id: int
    name: str


@dataclass(frozen=True, slots=True)
class Query:
    """A text and the ids of all objects that answer it."""

    text: str
    type: str
    """ontology, relevance, functionality, or a word of the file's own."""
    instances: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Truth:
    """Surface points with what they belong to."""

    points: NDArray[np.float64]
    """(N, 3) metres in the world."""
    instance: NDArray[np.int64]
    """(N,): 0 = background."""
    category: NDArray[np.int64] | None
    """(N,), if the truth has categories."""
    objects: tuple[TrueObject, ...] = ()
    queries: tuple[Query, ...] = ()
    categories: Mapping[int, str] = field(default_factory=dict)
    """Number to name, ascending."""


def read_truth(folder: Path, queries: Path | None = None) -> Truth:
    """The truth of a folder; `queries` replaces its queries.json. Raises InputError."""
    path = folder / "gt_points.npz"
    asked = read_queries(queries or folder / "queries.json", missing_is_none=queries is None)
    if not path.exists():
        from openvox.formats.truth_meshes import mesh_truth  # which is made of this module's types

        found = mesh_truth(folder, asked)
        if found is not None:
            return found
        raise InputError(
            f"{folder} has no gt_points.npz; expected points with instances there (or ScanNet's or Replica's mesh with "
            "annotations), or name a recording with truth"
        )
    arrays = read_arrays(path, lambda name: name in ("points", "instance", "category"))
    arrays = {name: _plain(path, name, array) for name, array in arrays.items()}
    check_layout(path, arrays, {"points": ("<f8", ("points", 3)), "instance": ("<i8", ("points",))})
    if "category" in arrays:
        check_layout(path, arrays, {"instance": ("<i8", ("points",)), "category": ("<i8", ("points",))})
    if not len(arrays["points"]):
        raise InputError(f"{path} has no points; there is nothing to score against")
    objects, categories = _read_objects(folder / "objects.json")
    return Truth(
        points=arrays["points"],
        instance=arrays["instance"],
        category=arrays.get("category"),
        objects=objects,
        queries=asked,
        categories=categories,
    )


def read_queries(path: Path, *, missing_is_none: bool = False) -> tuple[Query, ...]:
    """Queries of a JSON file: {"queries": [{"type", "text", "instances"}]}. Raises InputError."""
    if missing_is_none and not path.exists():
        return ()
    entries = read_object(path).get("queries")
    if not isinstance(entries, list):
        raise InputError(f'{path} has no list "queries"; expected {{"queries": [{{"type", "text", "instances"}}]}}')
    return tuple(_query(entry, f"{path}: query {number}") for number, entry in enumerate(entries))


def _query(entry: Any, where: str) -> Query:
    fields = entry if isinstance(entry, dict) else {}
    instances = fields.get("instances")
    if not isinstance(instances, list) or not instances or not all(_is_id(i) for i in instances):
        raise InputError(f'{where} has "instances" {instances!r:.60}; expected the ids of all objects that answer it')
    return Query(_text(fields, "text", where), _text(fields, "type", where), tuple(sorted(instances)))


def _read_objects(path: Path) -> tuple[tuple[TrueObject, ...], dict[int, str]]:
    """Objects by id, and names of categories by number; nothing without the file."""
    if not path.exists():
        return (), {}
    content = read_object(path)
    entries, named = content.get("objects", []), content.get("categories", {})
    if not isinstance(entries, list) or not isinstance(named, dict):
        raise InputError(f'{path}: expected "objects", a list, and "categories", an object of name to number')
    objects: dict[int, TrueObject] = {}
    for number, entry in enumerate(entries):
        where = f"{path}: object {number}"
        if not isinstance(entry, dict) or not _is_id(entry.get("id")) or entry["id"] in objects:
            raise InputError(f"{where} has no id of its own; expected a whole number above 0, each once")
        objects[entry["id"]] = TrueObject(entry["id"], _text(entry, "name", where))
    categories: dict[int, str] = {}
    for name, number in named.items():
        if not _is_id(number) or number in categories:
            raise InputError(f"{path}: category {name!r:.60} has number {number!r:.60}; expected one of its own")
        categories[number] = _text({"name": name}, "name", f"{path}: category {number}")
    return tuple(objects[i] for i in sorted(objects)), dict(sorted(categories.items()))


def _plain(path: Path, name: str, array: NDArray[Any]) -> NDArray[Any]:
    """As float64 or int64, finite and within range."""
    if name == "points":
        points = array.astype(np.float64)
        if not (np.abs(points) < FAR).all():
            raise InputError(f"{path}: a point is not finite or farther than {FAR:g} m from the origin")
        return points
    if array.dtype.kind not in "iu" or (array.size and not (array.min() >= 0 and array.max() < MAX_ID)):
        raise InputError(f"{path}: array {name} holds {array.dtype}; expected whole numbers from 0 to below {MAX_ID}")
    return array.astype(np.int64)


def read_object(path: Path) -> dict[str, Any]:
    """A JSON object of a file that is not huge. Raises InputError."""
    try:
        size = path.stat().st_size
        if size > MAX_TEXT_BYTES:
            raise InputError(f"{path} has {size} bytes; expected at most {MAX_TEXT_BYTES}")
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no JSON ({error})") from None
    if not isinstance(content, dict):
        raise InputError(f"{path} holds {type(content).__name__}; expected a JSON object")
    return content


def _text(fields: Mapping[str, Any], key: str, where: str) -> str:
    value = fields.get(key)
    if not isinstance(value, str) or not value.strip() or any("\ud800" <= letter <= "\udfff" for letter in value):
        raise InputError(f'{where} has "{key}" {value!r:.60}; expected a text')
    return value


def _is_id(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 < value < MAX_ID
