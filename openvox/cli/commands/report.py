"""`openvox report`: a page to keep, in one file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = ("openvox report living.map.npz living.html", "openvox report living.map.npz living.trace.mcap living.html")


def report(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="MAP [TRACE] OUT.html", help="A map, its trace (else the one beside it), the page."),
    ],
    recording: Annotated[
        Path | None,
        typer.Option("--recording", metavar="FILE", help="Pictures from here, not from where the map says."),
    ] = None,
    json: options.Json = False,
) -> None:
    """Write a page to keep: the map to turn, its instances with pictures, decisions, growth, parameters, digests.

    One self-contained HTML file that asks no network for anything, readable on a phone.
    """
    from openvox.apps import report as application

    if len(files) not in (2, 3):
        raise typer.BadParameter(f"{len(files)} files were named; expected MAP [TRACE] OUT.html")
    second = files[1] if len(files) == 3 else None
    tables.show(application.report(files[0], second, files[-1], recording=recording), json, print_result)


def print_result(data: tables.Data) -> None:
    """The page, its size, and what it leaves out."""
    tables.wrote(data["out"], data["replaced"])
    print(f"{data['bytes'] / 1e6:.1f} MB, {data['instances']} instances")
    tables.notes(data)
