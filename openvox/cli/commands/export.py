"""`openvox export`: a map for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = (
    "openvox export living.map.npz living.ply",
    "openvox export living.map.npz living.csv",
)


def export(
    map_file: options.MapFile,
    out: Annotated[
        Path, typer.Argument(metavar="OUT.{ply,csv,jsonl}", help="ply: coloured points; csv, jsonl: a row an instance.")
    ],
    json: options.Json = False,
) -> None:
    """Write a map for other programs; the ending says how."""
    from openvox.apps import export as application

    tables.show(application.export(map_file, out), json, print_result)


def print_result(data: tables.Data) -> None:
    """How much was written, and where."""
    print(f"{data['instances']} instances, {data['voxels']} voxels")
    tables.wrote(data["output"], data["replaced"])
