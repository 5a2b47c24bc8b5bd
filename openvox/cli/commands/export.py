"""`openvox export`: a map for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox export living.map.npz living.ply",
    "openvox export living.map.npz living.glb",
    "openvox export living.map.npz living.yaml --occupancy --set occupancy.obstacle_high=0.5",
    "openvox export living.map.npz living.detections.jsonl --masks",
    "openvox export living.map.npz surface.ply --mesh",
)


def export(
    map_file: options.MapFile,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT.{ply,glb,csv,jsonl,yaml}",
            help="ply: coloured points; glb: a solid an instance; csv, jsonl: a row an instance.",
        ),
    ],
    occupancy: Annotated[
        bool, typer.Option("--occupancy", help="A grid for navigation: OUT.yaml of ROS map_server, and OUT.pgm.")
    ] = False,
    masks: Annotated[
        bool, typer.Option("--masks", help="OUT.jsonl: what each frame's camera sees of the map, as detections.")
    ] = False,
    mesh: Annotated[
        bool, typer.Option("--mesh", help="OUT.ply: a surface from the recording; wants the extra mesh (Open3D).")
    ] = False,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="REC.mcap", help="For --masks and --mesh, if it is not where the map names it."),
    ] = None,
    assignments: options.Assignments = None,
    json: options.Json = False,
) -> None:
    """Write a map for other programs; the ending says how."""
    from openvox.apps import export as application

    asked: list[application.What] = []
    asked += ["occupancy"] if occupancy else []
    asked += ["masks"] if masks else []
    asked += ["mesh"] if mesh else []
    if len(asked) > 1:
        raise typer.BadParameter(f"--{' and --'.join(asked)} are several files; write one after the other")
    result = application.export(
        map_file,
        out,
        asked[0] if asked else "map",
        recording=recording,
        assignments=assignments or [],
        progress=progress("meshing" if mesh else "rendering"),
    )
    tables.show(result, json, print_result)


def print_result(data: tables.Data) -> None:
    """How much was written, and where."""
    if "cells" in data:
        cells = ", ".join(f"{count} {name}" for name, count in data["cells"].items())
        print(f"{data['size'][0]} x {data['size'][1]} cells of {data['resolution']:g} m: {cells}")
        print(f"floor at z = {data['floor']:.2f} m")
        tables.wrote(data["picture"])
    elif "masks" in data:
        print(f"{data['masks']} masks in {data['frames']} frames of {data['recording']}")
    elif "triangles" in data:
        print(f"{data['vertices']} vertices, {data['triangles']} triangles from {data['recording']}")
    else:
        print(f"{data['instances']} instances, {data['voxels']} voxels")
    tables.wrote(data["output"], data["replaced"])
