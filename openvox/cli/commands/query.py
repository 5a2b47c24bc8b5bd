"""`openvox query`: a map asked in words."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = (
    'openvox query living.map.npz "somewhere to sit" "something to drink from" --top 3',
    'openvox query --live 127.0.0.1:40911 "a chair"',
    'openvox query living.map.npz "a red mug" --png mug.png',
)


def query(
    words: Annotated[
        list[str], typer.Argument(metavar="[MAP] TEXT...", help="STEM.map.npz, and what you look for, in words.")
    ],
    live: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Ask a live run, as it prints it; then without MAP.")
    ] = None,
    top: Annotated[int, typer.Option(min=1, metavar="K", help="Answers a text.")] = 3,
    models: options.AskingModels = None,
    png: Annotated[Path | None, typer.Option(metavar="FILE", help="A picture of the map with the answers lit.")] = None,
    rerun: Annotated[Path | None, typer.Option(metavar="FILE.rrd", help="The same for Rerun.")] = None,
    json: options.Json = False,
) -> None:
    """Ask a map in words: what fits best, and where it is."""
    from openvox.apps import answers
    from openvox.apps import query as application

    if live is not None:
        for name, value in (("--models", models), ("--png", png), ("--rerun", rerun)):
            if value is not None:
                raise typer.BadParameter(f"{name}: a live run encodes and shows what it is asked itself; leave it out")
        tables.show(application.query_live(live, words, top=top), json, print_result)
        return
    map_file, *texts = words
    if not texts:
        raise typer.BadParameter('expected a map and what you look for, as in: living.map.npz "a chair"')
    result = (
        application.query(Path(map_file), texts, top=top, models=models)
        if png is None and rerun is None
        else answers.query_and_show(Path(map_file), texts, top=top, models=models, png=png, rerun=rerun)
    )
    tables.show(result, json, print_result, "openvox", "export", map_file, "map.ply")


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
    for path in data.get("outputs", {}).values():
        if path is not None:
            tables.wrote(path)
