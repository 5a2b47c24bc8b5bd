"""`openvox shot`: a picture without a screen."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox shot living.trace.mcap frame40.png --frame 40",
    'openvox shot living.map.npz map.png --view "coloured by instance"',
)
SIDES = (200, 8000)


def shot(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, perception, map, trace or .rrd.")],
    out: Annotated[Path, typer.Argument(metavar="OUT.png", help="The picture.")],
    frame: Annotated[int | None, typer.Option(min=0, metavar="N", help="At this frame instead of the last.")] = None,
    view: Annotated[
        str | None, typer.Option(metavar="NAME", help="One view of the layout; a wrong name lists them.")
    ] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help="Of the picture, in pixels.")] = "1600x900",
    recording: Annotated[
        Path | None, typer.Option(metavar="REC.mcap", help="Of a trace, if it is not where the trace names it.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Make a picture of what view would show, on a machine without a screen.

    Rerun draws it, with the software renderer of Mesa if there is no graphics card.
    """
    from openvox.apps import shot as application

    result = application.shot(
        file,
        out,
        frame=frame,
        view=view,
        size=parsed_size(size),
        recording=recording,
        notice=lambda text: typer.echo(text, err=True),
        progress=progress("drawing"),
    )
    tables.show(result, json, print_result)


def parsed_size(text: str) -> tuple[int, int]:
    """WxH in pixels. Raises typer.BadParameter (exit 2)."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        width = height = 0
    if not all(SIDES[0] <= side <= SIDES[1] for side in (width, height)):
        raise typer.BadParameter(f"{text!r}: expected WxH from {SIDES[0]} to {SIDES[1]} pixels, as in 1600x900")
    return width, height


def print_result(data: tables.Data) -> None:
    """What the picture shows."""
    what = "" if data["frame"] is None else f", frame {data['frame']}"
    print(f"{data['kind']}{what}, {data['size'][0]}x{data['size'][1]} pixels")
    tables.wrote(data["output"], data["replaced"])
