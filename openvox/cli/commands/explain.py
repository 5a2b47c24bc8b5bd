"""`openvox explain`: why a mask went where it went."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = ("openvox explain living.trace.mcap --frame 40",)


def explain(
    trace: Annotated[Path, typer.Argument(metavar="TRACE", help="A trace made by replay, STEM.trace.mcap.")],
    frame: Annotated[int, typer.Option(min=0, metavar="N", help="The frame whose decisions to show.")],
    json: options.Json = False,
) -> None:
    """Show why each mask of a frame went where it went.

    Every candidate with its scores, the threshold, and the rule that decided.
    """
    from openvox.apps import explain as application

    tables.show(application.explain_frame(trace, frame), json, print_result)


DECISION = ("mask", "caption", "by", "instance", "voxels", "s_geo", "s_fea", "a", "visibility", "credibility")


LISTED = 4


def print_result(data: tables.Data) -> None:
    """The decisions of one frame, each with its best candidates, and what they led to."""
    if not data["looked"]:
        print(f"frame {data['frame']}: perception did not look at it, so nothing was decided")
        return
    print(f"frame {data['frame']}: {len(data['decisions'])} masks")
    if data["decisions"]:
        tables.print_table(
            ["mask", "caption", "rule", "instance", "voxels", "S_geo", "S_fea", "A", "R", "w", "candidates by A"],
            [[*(decision[name] for name in DECISION), _candidates(decision)] for decision in data["decisions"]],
            f"threshold of A: {data['decisions'][0]['threshold']:.3f}",
        )
    for event in data["events"]:
        print(f"instance {event['instance']} {event['kind']}: {tables.cell(event['text'])}")


def _candidates(decision: tables.Data) -> str:
    """The best few, as instance and A."""
    texts = [f"{c['instance']}: {c['a']:.2f}" for c in decision["candidates"]]
    return "  ".join(texts[:LISTED]) + ("  ..." if len(texts) > LISTED else "")
