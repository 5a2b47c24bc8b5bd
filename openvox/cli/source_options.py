"""How a source is read: the options of `ingest` and `doctor`, written once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

Layout = Annotated[
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
]
Fps = Annotated[float, typer.Option(min=0.001, metavar="N", help="Frame rate where there are no stamps.")]
InventStamps = Annotated[
    bool, typer.Option("--invent-stamps", help="Make new stamps at --fps, whatever the source says.")
]
Origin = Annotated[
    str, typer.Option(metavar="X,Y,Z", help="Whole metres to subtract from every pose (far coordinates, as UTM).")
]
Poses = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="A trajectory instead of the source's poses: TUM (by stamp) or KITTI (line N: frame N).",
    ),
]
Extrinsic = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="4x4, metres: from the depth camera to what the poses are of; identity."),
]
ColorFromDepth = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="4x4, metres: from the depth camera to the colour camera."),
]
World = Annotated[
    str | None, typer.Option(metavar="FRAME", help="Log: the frame to map in; map, odom or world if it is there.")
]
Camera = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Log: the camera's frame; its pictures name it. Folder without intrinsics: a file of them.",
    ),
]
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="ROLE=NAME",
        help="Log: the topic of color, depth, color_info, depth_info or pose; may be repeated.",
    ),
]
MaxGap = Annotated[
    float, typer.Option(metavar="SECONDS", help="Between two poses, up to which one is made in between.")
]
Tolerance = Annotated[float, typer.Option(metavar="SECONDS", help="Between colour and depth of one frame, at most.")]
DepthScale = Annotated[float, typer.Option(metavar="F", help="To multiply depth by, where its unit is another.")]
PoseAxes = Annotated[
    str,
    typer.Option(
        metavar="XYZ",
        help="Where x, y, z of the poses' camera point: RDF right, down, forward; RUB OpenGL; FLU a robot's body.",
    ),
]
PosesInverted = Annotated[bool, typer.Option("--poses-inverted", help="The source's poses are world-to-camera.")]
PoseShift = Annotated[
    float, typer.Option(metavar="SECONDS", help="Each picture takes the pose of so much later; below 0 earlier.")
]
