"""export: a map for other programs; the ending of the file's name, and what is asked for, say which form."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from openvox import __version__
from openvox.apps.described import described
from openvox.apps.exporting.points import points
from openvox.apps.exporting.table import write_table
from openvox.apps.info import check_kind
from openvox.apps.origin import belonging, recording_of
from openvox.core.errors import InputError
from openvox.core.export_parameters import ExportParameters
from openvox.core.parameters import from_assignments, updated
from openvox.core.types import InstanceMap
from openvox.formats.atomic import check_not_input, partial_file
from openvox.formats.map_npz import SUFFIX, read_map
from openvox.formats.ply import ply

What = Literal["map", "occupancy", "masks", "mesh"]
ENDINGS: dict[What, tuple[str, ...]] = {
    "map": (".ply", ".glb", ".csv", ".jsonl"),
    "occupancy": (".yaml",),
    "masks": (".jsonl",),
    "mesh": (".ply",),
}
GROUPS: dict[What, str] = {"occupancy": "occupancy", "masks": "rendered", "mesh": "mesh"}
"""Of parameters that each uses."""
Progress = Callable[[int, int], None] | None


def export(
    map_file: Path,
    out: Path,
    what: What = "map",
    *,
    recording: Path | None = None,
    assignments: Sequence[str] = (),
    progress: Progress = None,
) -> dict[str, Any]:
    """Write a map, or what is made of it; what was written. Raises InputError, OutputError. Metres.

    map: ply, a coloured point for each voxel of an instance; glb, a solid for each instance; csv, jsonl: a row, or an
    object, for each instance. occupancy: a grid in the form of map_server, .yaml with a .pgm beside it. masks: of the
    map in each frame of its recording, as perceive reads them.
    mesh: a surface from the recording, .ply. recording: where the map does not find its own.
    assignments: `group.name=value` texts."""
    form = out.suffix.lower()
    if form not in ENDINGS[what]:
        *most, last = ENDINGS[what]
        expected = f"{', '.join(most)} or {last}" if most else last
        raise InputError(f"{out} ends in {out.suffix or 'nothing'}; expected {expected}, which says the form")
    parameters = _parameters(what, assignments)
    if recording is not None and what not in ("masks", "mesh"):
        raise InputError(f"--recording {recording} has no effect here, because no pictures are needed; leave it out")
    check_kind(map_file, "map")
    result = read_map(map_file)
    for written in (out, out.with_suffix(".pgm")) if what == "occupancy" else (out,):
        check_not_input(written, *belonging(map_file, result.meta), recording)
    replaced = out.exists()
    about = {
        "output": str(out),
        "format": form.removeprefix("."),
        "instances": len(result.instance_id),
        "voxels": int((result.voxel_instance > 0).sum()),
        "replaced": replaced,
    }
    if what == "occupancy":
        return {**about, **_write_occupancy(result, out, parameters)}
    if what == "masks":
        source = _recording(map_file, result, recording)
        return {**about, **_write_masks(result, out, source, parameters, progress)}
    if what == "mesh":
        return {**about, **_write_mesh(result, out, _recording(map_file, result, recording), parameters, progress)}
    with partial_file(out) as partial:
        if form == ".ply":
            partial.write_bytes(points(result))
        elif form == ".glb":
            partial.write_bytes(_glb(map_file, result))
        elif form == ".csv":
            write_table(partial, result)
        else:
            _write_lines(partial, described(result))
    return about


def _parameters(what: What, assignments: Sequence[str]) -> ExportParameters:
    """Those of the form that is written may be set. Raises InputError."""
    changes = from_assignments(assignments)
    parameters = updated(ExportParameters(), changes, source="--set")
    for name in changes:
        if name.partition(".")[0] != GROUPS.get(what):
            raise InputError(f"--set: {name} has no effect on what is written here; leave it out")
    return parameters


def _recording(map_file: Path, result: InstanceMap, given: Path | None) -> Path:
    found = recording_of(map_file, result, given)
    if found is None:
        raise InputError(
            f"{map_file}: the recording that it was made from is not there, or is another one now; "
            "name it with --recording REC.mcap"
        )
    return found


def _glb(map_file: Path, result: InstanceMap) -> bytes:
    from openvox.apps.exporting.solids import solids
    from openvox.formats.glb import glb

    return glb(map_file.name.removesuffix(SUFFIX), solids(result), f"openvox {__version__}")


def _write_occupancy(result: InstanceMap, out: Path, parameters: ExportParameters) -> dict[str, Any]:
    from openvox.apps.exporting.occupancy import FREE, OCCUPIED, UNKNOWN, occupancy

    grid = occupancy(result, parameters.occupancy)
    picture = out.with_suffix(".pgm")
    with partial_file(out) as lines, partial_file(picture) as partial:
        lines.write_text(grid.yaml(picture.name), encoding="utf-8", newline="\n")
        partial.write_bytes(grid.pgm())
    names = {"free": FREE, "occupied": OCCUPIED, "unknown": UNKNOWN}
    return {
        "picture": str(picture),
        "size": [*grid.grey.shape[::-1]],
        "resolution": grid.resolution,
        "origin": list(grid.origin),
        "floor": grid.floor,
        "cells": {name: int((grid.grey == value).sum()) for name, value in names.items()},
    }


def _write_masks(
    result: InstanceMap, out: Path, recording: Path, parameters: ExportParameters, progress: Progress
) -> dict[str, Any]:
    from openvox.apps.exporting.rendered import rendered_masks

    counts: list[int] = []

    def counted() -> Iterator[dict[str, Any]]:
        for frame in rendered_masks(result, recording, parameters.rendered, progress):
            counts.append(len(frame["detections"]))
            yield frame

    with partial_file(out) as partial:
        _write_lines(partial, counted())
    return {"recording": str(recording), "frames": len(counts), "masks": sum(counts)}


def _write_mesh(
    result: InstanceMap, out: Path, recording: Path, parameters: ExportParameters, progress: Progress
) -> dict[str, Any]:
    from openvox.apps.exporting.mesh import labelled, surface

    vertices, triangles = surface(recording, parameters.mesh, progress)
    with partial_file(out) as partial:
        partial.write_bytes(ply(labelled(vertices, result), triangles, "openvox map, surface of the recording"))
    return {"recording": str(recording), "vertices": len(vertices), "triangles": len(triangles)}


def _write_lines(path: Path, objects: Iterable[Any]) -> None:
    """One JSON object a line."""
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for one in objects:
            file.write(json.dumps(one, ensure_ascii=False, allow_nan=False) + "\n")
