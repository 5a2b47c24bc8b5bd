"""`openvox explain`: why a mask went where it went, and where to look first."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import explained, options, tables

EXAMPLES = (
    "openvox explain living.trace.mcap --suspicious",
    "openvox explain living.trace.mcap --frame 40",
    "openvox explain living.trace.mcap --frame 40 --mask 3",
    "openvox explain living.trace.mcap --instance 17",
    "openvox explain living.trace.mcap --at 1.42,0.98,0.46",
)


def explain(
    trace: Annotated[Path, typer.Argument(metavar="TRACE", help="A trace made by replay, STEM.trace.mcap.")],
    frame: Annotated[int | None, typer.Option(min=0, metavar="N", help="The frame whose decisions to show.")] = None,
    mask: Annotated[int | None, typer.Option(min=0, metavar="M", help="With --frame: one mask in detail.")] = None,
    instance: Annotated[int | None, typer.Option(min=1, metavar="ID", help="The life of an instance.")] = None,
    at: Annotated[str | None, typer.Option(metavar="X,Y,Z", help="The history of the voxel there; metres.")] = None,
    suspicious: Annotated[bool, typer.Option("--suspicious", help="The decisions most likely wrong.")] = False,
    top: Annotated[int | None, typer.Option(min=1, metavar="K", help="With --suspicious: so many; else 20.")] = None,
    json: options.Json = False,
) -> None:
    """Show why masks went where they went, and which decisions are most likely wrong.

    One of --frame, --instance, --at and --suspicious. A mask: every candidate and what its score consisted of, the rule
    that decided, margins, the largest contributions, evidence for and against. Coordinates are metres in the world.
    """
    if mask is not None and frame is None:
        raise typer.BadParameter("--mask goes with --frame")
    asked = {"--frame": frame is not None, "--instance": instance is not None, "--at": at is not None}
    given = [name for name, is_given in {**asked, "--suspicious": suspicious}.items() if is_given]
    if not given:
        raise typer.BadParameter("expected one of --frame, --instance, --at and --suspicious")
    if len(given) > 1:
        raise typer.BadParameter(f"{' and '.join(given)} are given; give only one of them")
    if top is not None and not suspicious:
        raise typer.BadParameter("--top goes with --suspicious")
    point = None if at is None else options.point(at)
    from openvox.apps import explain as application

    result = application.explain(trace, frame=frame, mask=mask, instance=instance, at=point, top=top or application.TOP)
    if suspicious:
        tables.show(result, json, lambda data: explained.print_suspicious(data, trace))
    elif mask is not None:
        tables.show(result, json, explained.print_mask)
    elif frame is not None:
        tables.show(result, json, explained.print_frame)
    else:
        tables.show(result, json, explained.print_voxel if point else explained.print_instance)
