"""`openvox doctor`: what looks wrong, before anything is converted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables
from openvox.cli import source_options as how
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox doctor scans/living",
    "openvox doctor living.mcap",
    "openvox doctor living.perception.mcap",
    "openvox doctor robot_bag --pose-axes FLU",
)


def doctor(
    source: Annotated[
        Path,
        typer.Argument(metavar="SOURCE|FILE", help="A folder of frames, a robot's log, a recording, or perception."),
    ],
    layout: how.Layout = "auto",
    fps: how.Fps = 30.0,
    invent_stamps: how.InventStamps = False,
    origin: how.Origin = "0,0,0",
    poses: how.Poses = None,
    extrinsic: how.Extrinsic = None,
    color_from_depth: how.ColorFromDepth = None,
    world: how.World = None,
    camera: how.Camera = None,
    topics: how.Topics = None,
    max_gap: how.MaxGap = 0.2,
    tolerance: how.Tolerance = 0.02,
    depth_scale: how.DepthScale = 1.0,
    pose_axes: how.PoseAxes = "RDF",
    poses_inverted: how.PosesInverted = False,
    pose_shift: how.PoseShift = 0.0,
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    json: options.Json = False,
) -> None:
    """Say what is there and what looks wrong: units, axes, stamps, registration, masks.

    Nothing is written. The options are those of ingest, so that a cure can be tried. At most 400 frames are looked
    at; where the camera moves too little to tell, nothing is said. Exit code 3 when something was found.
    """
    shift, named = options.origin(origin), options.pairs("--topic", topics or [])
    from openvox.apps import doctor as application

    result = application.doctor(
        source,
        format=layout,
        fps=fps,
        invent_stamps=invent_stamps,
        origin=shift,
        poses=poses,
        extrinsic=extrinsic,
        color_from_depth=color_from_depth,
        world=world,
        camera=camera,
        topics=named,
        max_gap=max_gap,
        tolerance=tolerance,
        depth_scale=depth_scale,
        pose_axes=pose_axes,
        poses_inverted=poses_inverted,
        pose_shift=pose_shift,
        start=start,
        end=end,
        stride=stride,
        progress=progress("looking"),
    )
    tables.show(result, json, print_result)
    if result.findings:
        raise typer.Exit(3)


def print_result(data: tables.Data) -> None:
    """What was looked at, and each finding with its figure, cause and cure."""
    print(f"{data['kind']}: {data['frames']} frames were looked at")
    tables.notes(data)
    for finding in data["findings"]:
        print(f"\n{finding['code']}: {tables.cell(finding['what'])}")
        for name in ("figure", "cause", "cure"):
            print(f"  {name:<6}  {tables.cell(finding[name])}")
    if not data["findings"]:
        print("nothing looks wrong")
