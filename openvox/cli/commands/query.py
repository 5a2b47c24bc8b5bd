"""`openvox query`: a map asked in words."""

from __future__ import annotations

from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = ('openvox query living.map.npz "somewhere to sit" "something to drink from" --top 3',)


def query(
    map_file: options.MapFile,
    text: Annotated[list[str], typer.Argument(metavar="TEXT...", help="What you look for, in words.")],
    top: Annotated[int, typer.Option(min=1, metavar="K", help="Answers a text.")] = 3,
    models: options.AskingModels = None,
    json: options.Json = False,
) -> None:
    """Ask a map in words: what fits best, and where it is."""
    from openvox.apps import query as application

    tables.show(
        application.query(map_file, text, top=top, models=models),
        json,
        print_result,
        "openvox",
        "export",
        map_file,
        "map.ply",
    )


def print_result(data: tables.Data) -> None:
    """The answers of each text, best first."""
    for asked in data["queries"]:
        if not asked["answers"]:
            print(f"{asked['text']!r}: the map has no instances")
            continue
        tables.print_table(
            ["instance", "caption", "score", "center (m)", "voxels"],
            [
                [a["instance"], a["caption"], a["score"], [f"{x:.2f}" for x in a["center"]], a["voxels"]]
                for a in asked["answers"]
            ],
            repr(asked["text"]) if asked["found"] else f"{asked['text']!r}: nothing fits well; the nearest are",
        )
