"""`openvox recover`: what is whole in a broken file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = (
    "openvox recover broken.mcap whole.mcap",
    "openvox recover live.mcap.partial saved.mcap",
)


def recover(
    broken: Annotated[
        Path, typer.Argument(metavar="BROKEN.mcap", help="A recording, perception or trace: cut, damaged, .partial.")
    ],
    out: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="The file to write.")],
    json: options.Json = False,
) -> None:
    """Save what is whole in a broken recording, perception or trace.

    Every chunk whose checksum is right is kept; what was lost is said by topic and time. Exit code 3 when something
    was lost.
    """
    from openvox.apps import recover as application

    result = application.recover(broken, out)
    tables.show(result, json, print_result)
    if result.lost:
        raise typer.Exit(3)


def print_result(data: tables.Data) -> None:
    """What was kept, and each stretch of time that was lost."""
    tables.print_table(["topic", "messages"], list(data["kept"].items()), f"kept of the {data['kind']}")
    if data["lost"]:
        rows: dict[tuple[str, str, str], list[str]] = {}
        for loss in data["lost"]:
            when = (_seconds(loss["from"], "the beginning"), _seconds(loss["to"], "the end"), loss["reason"])
            rows.setdefault(when, []).append(loss["topic"])
        tables.print_table(
            ["after", "before", "why", "topics"], [[*when, " ".join(topics)] for when, topics in rows.items()], "lost"
        )
    else:
        print("nothing was lost")
    print(f"{data['kind']} digest {data['digest']}")
    tables.wrote(data["output"], data["replaced"])


def _seconds(stamp: int | None, otherwise: str) -> str:
    return otherwise if stamp is None else f"{stamp // 10**9}.{stamp % 10**9:09d} s"
