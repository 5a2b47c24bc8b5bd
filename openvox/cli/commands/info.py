"""`openvox info`: what a file holds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from openvox.cli import options, tables

HISTOGRAMS = ("scores", "caption_scores", "areas")
BAR = 40
"""Characters of the longest bar."""
EXAMPLES = (
    "openvox info living.perception.mcap",
    "openvox info living.mcap",
    "openvox info --parameters",
)


def info(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="A recording, perception, map, trace or .rrd.")
    ] = None,
    parameters: Annotated[
        bool, typer.Option("--parameters", help="All parameters with unit, range, default and reason.")
    ] = False,
    json: options.Json = False,
) -> None:
    """Say what a file holds and what it was made from."""
    if (file is None) != parameters:
        raise typer.BadParameter("expected a FILE or --parameters, one of the two")
    from openvox.apps import info as application

    if file is None:
        tables.show(application.parameters(), json, print_parameters)
    else:
        tables.show(application.info(file), json, print_file)


def print_file(data: tables.Data) -> None:
    """Name and value, one a line; histograms of masks as bars."""
    histograms = {key: data[key] for key in HISTOGRAMS if key in data}
    tables.pairs({key: value for key, value in data.items() if key not in histograms})
    for name, rows in histograms.items():
        print(name.replace("_", " "))
        most = max((row["masks"] for row in rows), default=0)
        for row in rows:
            bar = "#" * -(-row["masks"] * BAR // most)
            print(f"  from {row['from']:>8g}  {row['masks']:>8}  {bar}".rstrip())


def print_parameters(data: tables.Data) -> None:
    """Every parameter with unit, range, default and reason, by the command whose --set takes it."""
    for command in dict.fromkeys(row["command"] for row in data["parameters"]):
        rows = [row for row in data["parameters"] if row["command"] == command]
        tables.print_table(
            ["parameter", "default", "unit", "range", "why"],
            [[row["name"], _setting(row["default"]), row["unit"], row["range"], row["why"]] for row in rows],
            f"openvox {command} --set",
        )


def _setting(value: Any) -> str:
    """As one would type it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
