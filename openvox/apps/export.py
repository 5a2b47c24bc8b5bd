"""export: a map for other programs; the ending of the file's name says which form."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from openvox.apps.described import described, voxel_centers
from openvox.core.colors import instance_color
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.atomic import partial_file
from openvox.formats.map_npz import read_map

VERTEX = np.dtype(
    [
        *((axis, "<f4") for axis in "xyz"),
        *((color, "u1") for color in ("red", "green", "blue")),
        ("instance", "<i4"),
        ("confidence", "<f4"),
    ]
)
_PLY_NAMES = {"f4": "float", "u1": "uchar", "i4": "int"}
_FORMULA = ("=", "+", "-", "@")
"""A cell that begins so is run as a formula by spreadsheets."""


def export(map_file: Path, out: Path) -> dict[str, Any]:
    """Write the map as .ply, .csv or .jsonl; what was written. Raises InputError, OutputError.

    ply: a coloured point for each voxel of an instance. csv, jsonl: a row, or an object, for each instance. Metres.
    """
    form = out.suffix.lower().removeprefix(".")
    if form not in ("ply", "csv", "jsonl"):
        raise InputError(f"{out} ends in {out.suffix or 'nothing'}; expected .ply, .csv or .jsonl, which says the form")
    result = read_map(map_file)
    replaced = out.exists()
    with partial_file(out) as partial:
        if form == "ply":
            partial.write_bytes(_ply(result))
        elif form == "csv":
            _write_csv(partial, result)
        else:
            lines = [json.dumps(one, ensure_ascii=False, allow_nan=False) for one in described(result)]
            partial.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8", newline="\n")
    return {
        "output": str(out),
        "format": form,
        "instances": len(result.instance_id),
        "voxels": int((result.voxel_instance > 0).sum()),
        "replaced": replaced,
    }


def _ply(result: InstanceMap) -> bytes:
    """Binary little-endian PLY of the centres of all voxels that belong to an instance, in the map's order."""
    mine = result.voxel_instance > 0
    vertices = np.zeros(int(mine.sum()), VERTEX)
    for axis, values in zip("xyz", voxel_centers(result)[mine].T, strict=True):
        vertices[axis] = values
    ids, place = np.unique(result.voxel_instance[mine], return_inverse=True)
    colors = np.array([instance_color(int(i)) for i in ids], np.uint8).reshape(-1, 3)[place]
    for name, values in zip(("red", "green", "blue"), colors.T, strict=True):
        vertices[name] = values
    vertices["instance"], vertices["confidence"] = result.voxel_instance[mine], result.voxel_confidence[mine]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment openvox map, voxels of {result.voxel_size:g} m",
        f"element vertex {len(vertices)}",
        *(f"property {_PLY_NAMES[VERTEX[name].str[1:]]} {name}" for name in VERTEX.names or ()),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in header).encode("ascii") + vertices.tobytes()


def _write_csv(path: Path, result: InstanceMap) -> None:
    """One row an instance, after a header."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = ["id", "caption", "state", "observations", "confidence", "voxels", "first_frame", "last_frame"]
        places = [f"{what}_{axis}" for what in ("center", "min", "max") for axis in "xyz"]
        writer.writerow([*names, *places])
        for one in described(result):
            low, high = one["bounds"]
            texts = [one["instance"], _cell(one["caption"]), *(one[name] for name in names[2:])]
            writer.writerow([*texts, *one["center"], *low, *high])


def _cell(text: str) -> str:
    """A text on one line that a spreadsheet shows and does not run."""
    text = " ".join(text.split())
    return f"'{text}" if text.startswith(_FORMULA) else text
