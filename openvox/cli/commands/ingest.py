"""`openvox ingest`: folders to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox ingest scans/living living.mcap",
    "openvox ingest scans/office office.mcap --format replica --end 200 --stride 2",
)


def ingest(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="A folder of exported RGB-D frames.")],
    recording: Annotated[Path, typer.Argument(metavar="REC.mcap", help="The recording to write.")],
    layout: Annotated[
        Literal["auto", "scannet", "replica"], typer.Option("--format", help="Layout of the folder; auto looks.")
    ] = "auto",
    fps: Annotated[float, typer.Option(min=0.001, metavar="N", help="Frame rate where there are no stamps.")] = 30.0,
    origin: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Whole metres to subtract from every pose (far coordinates, as UTM).")
    ] = "0,0,0",
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    json: options.Json = False,
) -> None:
    """Make a recording of a folder of RGB-D frames.

    It holds colour, depth, poses, intrinsics, and the ground truth where there is one. Frames with a pose that is no
    pose are left out and counted.
    """
    shift = options.origin(origin)
    from openvox.apps import ingest as application

    result = application.ingest(
        source,
        recording,
        format=layout,
        fps=fps,
        origin=shift,
        start=start,
        end=end,
        stride=stride,
        progress=progress("reading"),
    )
    tables.show(result, json, print_result, "openvox", "perceive", recording)


def print_result(data: tables.Data) -> None:
    """What was recorded, and what was left out and why."""
    near, far = data["depth_range_m"]
    print(
        f"{data['frames']} frames, numbers {data['first']} to {data['last']}, {data['seconds']:.1f} s, path "
        f"{data['path_length_m']:.2f} m, depth {near:.2f} to {far:.2f} m, "
        f"{'with' if data['has_truth'] else 'without'} ground truth"
    )
    for reason, count in data["dropped"].items():
        print(f"left out: {count} frames ({reason})")
    tables.notes(data)
    print(f"recording digest {data['digest']}")
    tables.wrote(data["output"], data["replaced"])
