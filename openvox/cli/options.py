"""Options that several commands share, written once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout; everything else goes to stderr.")]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="K=V", help="A parameter, as association.threshold=0.3; may be repeated."),
]
Params = Annotated[
    Path | None,
    typer.Option("--params", metavar="FILE.toml", help="Parameters, one table a group; --set goes over it."),
]
MaxMemory = Annotated[
    int | None,
    typer.Option("--max-memory", metavar="MB", min=1, help="Stop with a sentence before the process needs more."),
]
Start = Annotated[int | None, typer.Option("--start", min=0, metavar="N", help="First frame number.")]
End = Annotated[int | None, typer.Option("--end", min=0, metavar="N", help="Frame number to stop before.")]
Stride = Annotated[
    int, typer.Option("--stride", min=1, metavar="N", help="Every Nth frame: (frame - start) mod N = 0.")
]
Engine = Annotated[
    Literal["cpu", "torch"],
    typer.Option(help="What computes; torch wants its extra and takes a GPU if there is one. The bytes are the same."),
]
AskingModels = Annotated[
    Path | None,
    typer.Option("--models", metavar="FILE.toml", help="The models of perceive, if the encoder was one of your own."),
]
Dask = Annotated[
    str | None,
    typer.Option("--dask", metavar="ADDRESS", help="On the Dask cluster of this scheduler; wants the extra cluster."),
]
Categories = Annotated[
    Path | None,
    typer.Option(
        "--classes",
        metavar="FILE",
        help="Names, one a line, for colours by category; without it a category is the noun of a caption.",
    ),
]
Recording = Annotated[Path, typer.Argument(metavar="REC.mcap", help="A recording made by ingest.")]
MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="A map made by replay, STEM.map.npz.")]


def origin(text: str) -> tuple[int, int, int]:
    """X,Y,Z in whole metres, for `ingest --origin`. Raises typer.BadParameter (exit 2)."""
    try:
        x, y, z = (int(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r}: expected X,Y,Z in whole metres, as in 455200,5411900,0") from None
    return x, y, z


def pairs(option: str, texts: list[str]) -> dict[str, str]:
    """ROLE=NAME, each role once. Raises typer.BadParameter (exit 2)."""
    found: dict[str, str] = {}
    for text in texts:
        role, equals, name = text.partition("=")
        if not equals or not name or role in found:
            raise typer.BadParameter(f"{option} {text}: expected ROLE=NAME, each role once")
        found[role] = name
    return found


def point(text: str) -> tuple[float, float, float]:
    """X,Y,Z in metres, for `explain --at`. Raises typer.BadParameter (exit 2)."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r}: expected X,Y,Z in metres, as in 1.42,0.98,0.46") from None
    return x, y, z
