"""The commands, one file each: options, one call, print. What a command does stands in the app of its name."""

from __future__ import annotations

from typing import Annotated

import typer

from openvox import __version__
from openvox.cli.commands import (
    compare,
    doctor,
    evaluate,
    explain,
    export,
    info,
    ingest,
    live,
    perceive,
    query,
    recover,
    replay,
    report,
    shot,
    sweep,
    view,
)

app = typer.Typer(
    rich_markup_mode=None,  # plain help: quick, and the same text in docs/commands.md
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"max_content_width": 100},
    epilog="--debug, anywhere: the traceback of an error.\n\n"
    "Exit codes: 0 done; 1 a sentence about the input; 2 wrong usage; 3 done, but something was found or lost.",
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"openvox {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """Turn a robot's RGB-D log into an instance map that you can ask in words, and see why each mask went where."""


def _examples(lines: tuple[str, ...]) -> str:
    return "\b\nExample:\n" + "\n".join(f"  {line}" for line in lines)


# In the order of the data's way, which is the order of the help.
for command, examples in (
    (doctor.doctor, doctor.EXAMPLES),
    (ingest.ingest, ingest.EXAMPLES),
    (recover.recover, recover.EXAMPLES),
    (perceive.perceive, perceive.EXAMPLES),
    (replay.replay, replay.EXAMPLES),
    (live.live, live.EXAMPLES),
    (sweep.sweep, sweep.EXAMPLES),
    (query.query, query.EXAMPLES),
    (evaluate.evaluate, evaluate.EXAMPLES),
    (explain.explain, explain.EXAMPLES),
    (compare.compare, compare.EXAMPLES),
    (export.export, export.EXAMPLES),
    (report.report, report.EXAMPLES),
    (info.info, info.EXAMPLES),
    (view.view, view.EXAMPLES),
    (shot.shot, shot.EXAMPLES),
):
    app.command(epilog=_examples(examples))(command)
