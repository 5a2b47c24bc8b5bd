"""`openvox view`: any file of openvox in Rerun."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox view living.trace.mcap",
    "openvox view living.map.npz --web",
    "openvox view living.trace.mcap --save living.rrd",
)


def view(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Recordings, perceptions, maps, traces or .rrd files.")
    ],
    web: Annotated[bool, typer.Option("--web", help="In a browser, served from this machine until Ctrl-C.")] = False,
    save: Annotated[Path | None, typer.Option(metavar="OUT.rrd", help="Write a file for Rerun instead.")] = None,
    recording: Annotated[
        Path | None, typer.Option(metavar="REC.mcap", help="Of a trace, if it is not where the trace names it.")
    ] = None,
    classes: options.Categories = None,
    bind: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Where --web listens; others can see it only if you change this.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, metavar="N", help="Of --web; 0 = any that is free.")] = 0,
    json: options.Json = False,
) -> None:
    """Show a recording, a map, a trace or an .rrd in Rerun.

    A trace is shown step by step, without mapping again.
    """
    if save is not None and web:
        raise typer.BadParameter("--save writes a file, --web serves one; choose")
    from openvox.apps import view as application

    result = application.view(
        files,
        recording=recording,
        classes=classes,
        save=save,
        web=web,
        bind=bind,
        port=port,
        notice=lambda text: typer.echo(text, err=True),
        progress=progress("drawing"),
        ready=lambda url: typer.echo(f"{url}\nCtrl-C ends it", err=json),
    )
    tables.show(result, json, print_result)


def print_result(data: tables.Data) -> None:
    """The file that was written, if any."""
    if data["output"]:
        tables.wrote(data["output"], data["replaced"])
