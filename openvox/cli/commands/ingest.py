"""`openvox ingest`: folders and logs to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox ingest scans/living living.mcap",
    "openvox ingest scans/office office.mcap --format replica --end 200 --stride 2",
    "openvox ingest robot_bag office.mcap --topic color=/front/image_raw/compressed",
    "openvox ingest robot_bag office.mcap --poses lidar_slam.txt --extrinsic lidar_from_camera.txt",
)


def ingest(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="A folder of RGB-D frames, or a robot's log.")],
    recording: Annotated[Path, typer.Argument(metavar="REC.mcap", help="The recording to write.")],
    layout: Annotated[
        Literal[
            "auto",
            "ros",
            "scannet",
            "replica",
            "sens",
            "tum",
            "7scenes",
            "open3d",
            "stray",
            "foxglove",
            "record3d",
        ],
        typer.Option("--format", help="Layout of the source; auto looks."),
    ] = "auto",
    fps: Annotated[float, typer.Option(min=0.001, metavar="N", help="Frame rate where there are no stamps.")] = 30.0,
    origin: Annotated[
        str, typer.Option(metavar="X,Y,Z", help="Whole metres to subtract from every pose (far coordinates, as UTM).")
    ] = "0,0,0",
    poses: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A trajectory instead of the source's poses: TUM (by stamp) or KITTI (line N: frame N).",
        ),
    ] = None,
    extrinsic: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="4x4, metres: from the depth camera to what the poses are of; identity."),
    ] = None,
    color_from_depth: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="4x4, metres: from the depth camera to the colour camera."),
    ] = None,
    world: Annotated[
        str | None, typer.Option(metavar="FRAME", help="Log: the frame to map in; map, odom or world if it is there.")
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Log: the camera's frame; its pictures name it. Folder without intrinsics: a file of them.",
        ),
    ] = None,
    topics: Annotated[
        list[str] | None,
        typer.Option(
            "--topic",
            metavar="ROLE=NAME",
            help="Log: the topic of color, depth, color_info, depth_info or pose; may be repeated.",
        ),
    ] = None,
    max_gap: Annotated[
        float, typer.Option(metavar="SECONDS", help="Between two poses, up to which one is made in between.")
    ] = 0.2,
    tolerance: Annotated[
        float, typer.Option(metavar="SECONDS", help="Between colour and depth of one frame, at most.")
    ] = 0.02,
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    json: options.Json = False,
) -> None:
    """Make a recording of a folder of RGB-D frames or a robot's log.

    It holds colour, depth, poses, intrinsics, and the ground truth where there is one. Frames without a pose, or
    without colour, are left out and counted by reason. docs/sources.md has a line for each source.
    """
    shift, named = options.origin(origin), options.pairs("--topic", topics or [])
    from openvox.apps import ingest as application

    result = application.ingest(
        source,
        recording,
        format=layout,
        fps=fps,
        origin=shift,
        poses=poses,
        extrinsic=extrinsic,
        color_from_depth=color_from_depth,
        world=world,
        camera=camera,
        topics=named,
        max_gap=max_gap,
        tolerance=tolerance,
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
