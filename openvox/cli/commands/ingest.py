"""`openvox ingest`: folders and logs to a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables
from openvox.cli import source_options as how
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
    for finding in data["findings"]:
        print(f"doctor: {tables.cell(finding['what'])} ({tables.cell(finding['cure'])})")
    print(f"recording digest {data['digest']}")
    tables.wrote(data["output"], data["replaced"])
