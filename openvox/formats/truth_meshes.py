"""Ground truth as data sets ship it, on meshes: ScanNet's annotations and Replica's, as points with instances."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.formats.ply import read_ply
from openvox.formats.truth import MAX_ID, Query, TrueObject, Truth, read_object

BACKGROUND = {"wall", "floor", "ceiling"}
"""Labels whose surfaces are no objects; they keep their category."""
LABELS = "scannetv2-labels.combined.tsv"
CELL = 0.02
"""Metres: of each cell and instance one point is kept, where a mesh is finer than that."""


def mesh_truth(folder: Path, queries: tuple[Query, ...]) -> Truth | None:
    """The truth of a folder of ScanNet or Replica; None if it is neither. Raises InputError."""
    for base in (folder, folder / "habitat"):
        if (base / "info_semantic.json").is_file() and (base / "mesh_semantic.ply").is_file():
            return _replica(base, queries)
    mesh, groups, segments = (
        next(iter(sorted(path for path in folder.glob(pattern) if "_vh_clean.a" not in path.name)), None)
        for pattern in ("*_vh_clean_2.ply", "*.aggregation.json", "*_vh_clean_2*.segs.json")
    )
    if mesh is None or groups is None or segments is None:
        return None
    return _scannet(folder, mesh, groups, segments, queries)


def _scannet(folder: Path, mesh: Path, groups: Path, segments: Path, queries: tuple[Query, ...]) -> Truth:
    points = _vertices(mesh)
    segment = _whole_numbers(segments, read_object(segments).get("segIndices"), "segIndices")
    if len(segment) != len(points):
        raise InputError(
            f"{segments} has {len(segment)} segments, {mesh.name} {len(points)} vertices; expected as many"
        )
    numbers = _nyu40(folder)
    instance, category = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    objects: list[TrueObject] = []
    categories: dict[int, str] = {}
    found = read_object(groups).get("segGroups")
    if not isinstance(found, list):
        raise InputError(f'{groups} has no list "segGroups"')
    labels = sorted({str(group.get("label")) for group in found if isinstance(group, dict)})
    for place, group in enumerate(found):
        if (
            not isinstance(group, dict)
            or not isinstance(group.get("objectId"), int)
            or not isinstance(group.get("label"), str)
        ):
            raise InputError(f'{groups}: segGroups {place} has no "objectId" and "label"')
        label = group["label"]
        kind, name = numbers.get(label, (0, "")) if numbers else (labels.index(label) + 1, label)
        rows = np.isin(segment, _whole_numbers(groups, group.get("segments"), f"segments of group {place}"))
        category[rows] = kind
        if kind:
            categories[kind] = name
        if label not in BACKGROUND and 0 <= group["objectId"] < MAX_ID - 1:
            instance[rows] = group["objectId"] + 1
            objects.append(TrueObject(group["objectId"] + 1, f"{label} {group['objectId'] + 1}"))
    objects.sort(key=lambda one: one.id)
    return Truth(points, instance, category, tuple(objects), queries, dict(sorted(categories.items())))


def _nyu40(folder: Path) -> dict[str, tuple[int, str]]:
    """NYU40's number and name of each label, if ScanNet's table lies in the folder or above it."""
    path = next((base / LABELS for base in (folder, folder.resolve().parent) if (base / LABELS).is_file()), None)
    if path is None:
        return {}
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file, delimiter="\t"))
        return {row["raw_category"]: (int(row["nyu40id"]), row["nyu40class"]) for row in rows if row["nyu40id"]}
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(
            f"{path} cannot be read ({error!r:.200}); expected raw_category, nyu40id, nyu40class"
        ) from error


def _replica(folder: Path, queries: tuple[Query, ...]) -> Truth:
    path = folder / "mesh_semantic.ply"
    mesh = read_ply(path)
    points = _vertices(path, mesh)
    face = mesh.get("face")
    names = face.dtype.names if face is not None else None
    corners = next((name for name in ("vertex_indices", "vertex_index") if names and name in names), None)
    if face is None or corners is None or "object_id" not in (names or ()):
        raise InputError(f"{path} has no faces with vertex_indices and object_id")
    index = face[corners].astype(np.int64)
    if index.size and not (index.min() >= 0 and index.max() < len(points)):
        raise InputError(f"{path}: a face names vertex {int(index.max())} of {len(points)}")
    classes, objects = _replica_objects(folder / "info_semantic.json")
    numbers, place = np.unique(face["object_id"].astype(np.int64), return_inverse=True)
    category = np.array([classes.get(one, 0) for one in numbers.tolist()], np.int64)[place]
    instance = np.array([one + 1 if one in objects else 0 for one in numbers.tolist()], np.int64)[place]
    centres = points[index].mean(1)
    rows = _thinned(centres, instance)
    categories = {kind: name for kind, name in _replica_classes(folder / "info_semantic.json").items() if kind > 0}
    named = tuple(TrueObject(one + 1, f"{objects[one]} {one + 1}") for one in sorted(objects))
    return Truth(centres[rows], instance[rows], category[rows], named, queries, categories)


def _replica_classes(path: Path) -> dict[int, str]:
    entries: Any = read_object(path).get("classes")
    try:
        return {int(one["id"]): str(one["name"]) for one in sorted(entries, key=lambda one: int(one["id"]))}
    except (TypeError, KeyError, ValueError) as error:
        raise InputError(
            f'{path}: "classes" cannot be read ({error!r:.100}); expected a list of id and name'
        ) from error


def _replica_objects(path: Path) -> tuple[Mapping[int, int], Mapping[int, str]]:
    """Class of every object by its number, and the class names of those that are no background."""
    classes: dict[int, int] = {}
    names: dict[int, str] = {}
    try:
        for one in read_object(path).get("objects", []):
            number, kind, name = int(one["id"]), int(one["class_id"]), str(one["class_name"])
            if not (0 <= number < MAX_ID - 1 and kind < MAX_ID):
                raise ValueError(f"object {number} of class {kind}")
            classes[number] = max(kind, 0)
            if kind > 0 and name not in BACKGROUND:
                names[number] = name
    except (TypeError, KeyError, ValueError, AttributeError) as error:
        raise InputError(
            f'{path}: "objects" cannot be read ({error!r:.100}); expected id, class_id, class_name'
        ) from error
    return classes, names


def _vertices(path: Path, mesh: Mapping[str, NDArray[Any]] | None = None) -> NDArray[np.float64]:
    rows = (mesh or read_ply(path)).get("vertex")
    if rows is None or not {"x", "y", "z"} <= set(rows.dtype.names or ()) or not len(rows):
        raise InputError(f"{path} has no vertices with x, y, z")
    points = np.stack([rows[axis] for axis in "xyz"], 1).astype(np.float64)
    if not (np.abs(points) < 1e6).all():
        raise InputError(f"{path}: a vertex is not finite, or farther than 1e6 m from the origin")
    return points


def _whole_numbers(path: Path, values: Any, what: str) -> NDArray[np.int64]:
    if not isinstance(values, list) or not all(isinstance(value, int) and abs(value) < MAX_ID for value in values):
        raise InputError(f"{path}: {what} is no list of whole numbers")
    return np.array(values, np.int64)


def _thinned(points: NDArray[np.float64], instance: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of the first point of each cell and instance, ascending."""
    cells = np.column_stack([np.floor(points / CELL).astype(np.int64), instance])
    return np.sort(np.unique(cells, axis=0, return_index=True)[1])
