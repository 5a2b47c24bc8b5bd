"""`openvox report`: a page to keep, in one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = (
    "openvox report living.map.npz living.html",
    "openvox report living.map.npz other.map.npz both.html",
    "openvox report sweep/ sweep.html",
)


def report(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="MAP [TRACE|MAP2] OUT.html | SWEEP_DIR OUT.html",
            help="A map, its trace (else the one beside it) or another map, or what a sweep made; then the page.",
        ),
    ],
    recording: Annotated[
        Path | None,
        typer.Option("--recording", metavar="FILE", help="Pictures from here, not from where the map says."),
    ] = None,
    classes: options.Categories = None,
    json: options.Json = False,
) -> None:
    """Write a page to keep: a map to turn, its instances, decisions and growth; or what differs between runs.

    One self-contained HTML file that asks no network for anything, readable on a phone.
    """
    from openvox.apps import report as application

    if len(files) not in (2, 3):
        raise typer.BadParameter(f"{len(files)} names; expected MAP [TRACE|MAP2] OUT.html, or SWEEP_DIR OUT.html")
    second = files[1] if len(files) == 3 else None
    tables.show(
        application.report(files[0], second, files[-1], recording=recording, classes=classes), json, print_result
    )


def print_result(data: tables.Data) -> None:
    """The page, its size, and what it leaves out."""
    tables.wrote(data["out"], data["replaced"])
    count = f", {data['instances']} instances" if data["instances"] is not None else ""
    print(f"{data['bytes'] / 1e6:.1f} MB{count}")
    tables.notes(data)
