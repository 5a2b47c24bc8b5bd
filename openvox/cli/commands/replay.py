"""`openvox replay`: the map and its trace."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox replay living.mcap --rerun living.rrd",
    "openvox replay living.mcap --set map.voxel_size=0.05 --out coarse",
    "openvox replay evening.mcap --resume morning.map.npz",
    "openvox replay living.mcap --passes 2 --out hindsight",
)


def replay(
    recording: options.Recording,
    perception: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of STEM.perception.mcap.")] = None,
    preset: Annotated[
        Literal["openvox", "official", "paper"],
        typer.Option(help="openvox: with the added rules; official: as the authors' code; paper: the plain method."),
    ] = "openvox",
    params: options.Params = None,
    assignments: options.Assignments = None,
    engine: options.Engine = "cpu",
    out: Annotated[
        str | None, typer.Option(metavar="STEM", help="Write STEM.map.npz and STEM.trace.mcap instead.")
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="MAP", help="Go on where this map stopped: the rest of its recording, or a second visit."),
    ] = None,
    passes: Annotated[
        int,
        typer.Option(min=1, metavar="N", help="Map all frames N times, each pass with the map before it as the prior."),
    ] = 1,
    max_memory: options.MaxMemory = None,
    rerun: Annotated[Path | None, typer.Option(metavar="FILE.rrd", help="Also write a file for Rerun.")] = None,
    images: Annotated[
        Literal["none", "jpeg", "all"],
        typer.Option(help="For Rerun: no pictures; colour as JPEG and drawings; or all as it is, and depth."),
    ] = "jpeg",
    every: Annotated[
        int, typer.Option(min=1, metavar="N", help="For Rerun: pictures and voxels of every N-th frame only.")
    ] = 1,
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    json: options.Json = False,
) -> None:
    """Build the instance map, and a trace of every decision.

    No model runs here, so other parameters take seconds. The same input gives the same bytes.
    """
    from openvox.apps import replay as application

    result = application.replay(
        recording,
        perception=perception,
        preset_name=preset,
        params=params,
        assignments=assignments or [],
        engine=engine,
        out=out,
        resume=resume,
        passes=passes,
        max_memory=max_memory,
        rerun=rerun,
        images=images,
        every=every,
        start=start,
        end=end,
        stride=stride,
        progress=progress("mapping"),
        notice=lambda text: typer.echo(text, err=True),
    )
    tables.show(result, json, print_result, "openvox", "query", result["outputs"]["map"], "somewhere to sit")


def print_result(data: tables.Data) -> None:
    """Speed, size, what decided, digests, files."""
    print(
        f"{data['frames']} frames in {data['seconds']:.2f} s ({data['frames_per_second']:.1f} a second), "
        f"preset {data['preset']}, engine {data['engine']}"
    )
    if data["looked"] < data["frames"]:
        print(f"perception looked at {data['looked']} of them; the others changed nothing")
    print(f"{data['voxels']} voxels, {data['instances']} instances")
    tables.print_table(
        ["ms", "mean", "median", "p95"],
        [[stage, *(figures[name] for name in ("mean", "median", "p95"))] for stage, figures in data["ms"].items()],
    )
    for number, row in enumerate(data["passes"][:-1], 1):
        digest = row["digests"]["map"]
        print(f"after pass {number}: {row['voxels']} voxels, {row['instances']} instances, map digest {digest}")
    print("decisions  " + tables.cell(data["decisions"]))
    for name, digest in data["digests"].items():
        print(f"{name} digest {digest}")
    for path in data["outputs"].values():
        if path:
            tables.wrote(path, path in data["replaced"])
