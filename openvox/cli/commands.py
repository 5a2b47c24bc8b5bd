"""The commands, one function each: options, one call, print. What a command does stands in the app of its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from openvox import __version__
from openvox.cli import options, tables
from openvox.cli.progress import progress
from openvox.core.errors import OpenvoxError

app = typer.Typer(
    rich_markup_mode=None,  # plain help: quick, and the same text in docs/commands.md
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"max_content_width": 100},
    epilog="--debug, anywhere: the traceback of an error.\n\n"
    "Exit codes: 0 done; 1 a sentence about the input; 2 wrong usage; 3 done, but something was found or lost.",
)


def _example(*lines: str) -> str:
    return "\b\nExample:\n" + "\n".join(f"  {line}" for line in lines)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"openvox {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it.")] = False,
) -> None:
    """Turn a robot's RGB-D log into an instance map that you can ask in words, and see why each mask went where."""


@app.command(
    epilog=_example(
        "openvox ingest scans/living living.mcap",
        "openvox ingest scans/office office.mcap --format replica --end 200 --stride 2",
    )
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
    tables.show(result, json, tables.ingest, "openvox", "perceive", recording)


@app.command(
    epilog=_example(
        "openvox perceive living.mcap",
        "openvox perceive living.mcap --detections my_detector.jsonl",
        "openvox perceive living.mcap office.mcap --set geometry.min_pixels=600",
    )
)
def perceive(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC.mcap...", help="Recordings made by ingest.")],
    frontend: Annotated[
        Literal["geometry", "oracle"] | None,
        typer.Option(
            help="geometry: regions from depth, no model (the default); oracle: the recording's own ground truth."
        ),
    ] = None,
    detections: Annotated[
        Path | None, typer.Option(metavar="FILE.jsonl", help="Masks and captions of a front end of your own.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of STEM.perception.mcap.")] = None,
    assignments: options.Assignments = None,
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    jobs: Annotated[int, typer.Option(min=1, metavar="N", help="Threads; the result is the same.")] = 1,
    json: options.Json = False,
) -> None:
    """Find masks, captions and embeddings in every frame.

    Once: what an earlier run did on the same frames in the same way is not done again. With several recordings one
    that fails does not stop the others; then the exit code is 3.
    """
    if len(recordings) > 1 and (out or detections):
        raise typer.BadParameter("--out and --detections belong to one recording; give one")
    from openvox.apps import perceive as application

    def work(recording: Path) -> Any:
        return application.perceive(
            recording,
            frontend=frontend,
            detections=detections,
            out=out,
            assignments=assignments or [],
            start=start,
            end=end,
            stride=stride,
            jobs=jobs,
            progress=progress("perceiving"),
        )

    if len(recordings) == 1:
        other: tuple[str | Path, ...] = ("--perception", out) if out else ()
        tables.show(work(recordings[0]), json, tables.perceive, "openvox", "replay", recordings[0], *other)
        return
    results = [_attempt(recording, work) for recording in recordings]
    tables.show({"recordings": results}, json, tables.perceive_several)
    if any("error" in result for result in results):
        raise typer.Exit(3)


def _attempt(recording: Path, work: Callable[[Path], Any]) -> dict[str, Any]:
    try:
        return {"recording": str(recording), **tables.plain(work(recording))}
    except OpenvoxError as error:
        return {"recording": str(recording), "error": str(error)}


@app.command(
    epilog=_example(
        "openvox replay living.mcap --rerun living.rrd",
        "openvox replay living.mcap --set map.voxel_size=0.05 --out coarse",
    )
)
def replay(
    recording: options.Recording,
    perception: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of STEM.perception.mcap.")] = None,
    preset: Annotated[
        Literal["openvox", "paper"], typer.Option(help="openvox: with the added rules; paper: the plain method.")
    ] = "openvox",
    params: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Parameters, one table a group; --set goes over it.")
    ] = None,
    assignments: options.Assignments = None,
    engine: Annotated[Literal["cpu"], typer.Option(help="What computes; every engine gives the same bytes.")] = "cpu",
    out: Annotated[
        str | None, typer.Option(metavar="STEM", help="Write STEM.map.npz and STEM.trace.mcap instead.")
    ] = None,
    rerun: Annotated[Path | None, typer.Option(metavar="FILE.rrd", help="Also write a file for Rerun.")] = None,
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
        rerun=rerun,
        start=start,
        end=end,
        stride=stride,
        progress=progress("mapping"),
        notice=lambda text: typer.echo(text, err=True),
    )
    tables.show(result, json, tables.replay, "openvox", "query", result["outputs"]["map"], "somewhere to sit")


@app.command(epilog=_example('openvox query living.map.npz "somewhere to sit" "something to drink from" --top 3'))
def query(
    map_file: options.MapFile,
    text: Annotated[list[str], typer.Argument(metavar="TEXT...", help="What you look for, in words.")],
    top: Annotated[int, typer.Option(min=1, metavar="K", help="Answers a text.")] = 3,
    json: options.Json = False,
) -> None:
    """Ask a map in words: what fits best, and where it is."""
    from openvox.apps import query as application

    tables.show(
        application.query(map_file, text, top=top), json, tables.query, "openvox", "export", map_file, "map.ply"
    )


@app.command(
    epilog=_example(
        "openvox evaluate living.map.npz --truth scans/living", "openvox evaluate living.map.npz --truth living.mcap"
    )
)
def evaluate(
    map_file: options.MapFile,
    truth: Annotated[Path, typer.Option(metavar="DIR|REC", help="Folder with gt_points.npz, or a recording.")],
    queries: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of the truth's queries.json.")] = None,
    classes: Annotated[
        Path | None, typer.Option(metavar="FILE", help="One name a line, in place of the truth's categories.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Score a map against ground truth.

    Instances, confidence, rendered masks, semantics and retrieval; the objects that were split, merged or missed by
    name.
    """
    from openvox.apps import evaluate as application

    result = application.evaluate(
        map_file, truth=truth, queries=queries, classes=classes, progress=progress("rendering")
    )
    tables.show(result, json, tables.evaluate, "openvox", "query", map_file, "somewhere to sit")


@app.command(epilog=_example("openvox explain living.trace.mcap --frame 40"))
def explain(
    trace: Annotated[Path, typer.Argument(metavar="TRACE", help="A trace made by replay, STEM.trace.mcap.")],
    frame: Annotated[int, typer.Option(min=0, metavar="N", help="The frame whose decisions to show.")],
    json: options.Json = False,
) -> None:
    """Show why each mask of a frame went where it went.

    Every candidate with its scores, the threshold, and the rule that decided.
    """
    from openvox.apps import explain as application

    tables.show(application.explain_frame(trace, frame), json, tables.explain)


@app.command(epilog=_example("openvox export living.map.npz living.ply", "openvox export living.map.npz living.csv"))
def export(
    map_file: options.MapFile,
    out: Annotated[
        Path, typer.Argument(metavar="OUT.{ply,csv,jsonl}", help="ply: coloured points; csv, jsonl: a row an instance.")
    ],
    json: options.Json = False,
) -> None:
    """Write a map for other programs; the ending says how."""
    from openvox.apps import export as application

    tables.show(application.export(map_file, out), json, tables.export)


@app.command(epilog=_example("openvox info living.mcap", "openvox info --parameters"))
def info(
    file: Annotated[Path | None, typer.Argument(metavar="FILE", help="A recording, perception, map or trace.")] = None,
    parameters: Annotated[
        bool, typer.Option("--parameters", help="All parameters with unit, range, default and reason.")
    ] = False,
    json: options.Json = False,
) -> None:
    """Say what a file holds and what it was made from."""
    if (file is None) != parameters:
        raise typer.BadParameter("expected a FILE or --parameters, one of the two")
    from openvox.apps import info as application

    if file is None:
        tables.show(application.parameters(), json, tables.parameters)
    else:
        tables.show(application.info(file), json, tables.pairs)
