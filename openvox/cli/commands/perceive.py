"""`openvox perceive`: masks, captions, embeddings."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox perceive living.mcap",
    "openvox perceive living.mcap --detections my_detector.jsonl",
    "openvox perceive living.mcap --models my.toml --set det.score=0.2",
    "openvox perceive living.mcap office.mcap --set geometry.min_pixels=600",
    "openvox perceive /data/*.mcap --dask tcp://10.0.0.5:8786",
)


def perceive(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC.mcap...", help="Recordings made by ingest.")],
    frontend: Annotated[
        Literal["offline", "geometry", "oracle", "models"] | None,
        typer.Option(
            help="offline: regions from depth, named by small models that come with openvox (the default); "
            "geometry: regions from depth alone; oracle: the recording's own ground truth; models: those of --models."
        ),
    ] = None,
    models: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help="Detector, segmenter and encoder of your own (implies --frontend models); see docs/models.md.",
        ),
    ] = None,
    detections: Annotated[
        Path | None, typer.Option(metavar="FILE.jsonl", help="Masks and captions of a front end of your own.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of STEM.perception.mcap.")] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="K=V",
            help="A parameter, as geometry.far=5, or with --models an option, as det.score=0.2; may be repeated.",
        ),
    ] = None,
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Recordings, or frames of one, at a time; by default one a core. The result is the same.",
        ),
    ] = None,
    dask: options.Dask = None,
    json: options.Json = False,
) -> None:
    """Find masks, captions and embeddings in every frame.

    Once: what an earlier run did on the same frames in the same way is not done again. Several recordings are done
    side by side; one that fails does not stop the others, and then the exit code is 3.
    """
    if (len(recordings) > 1 or dask) and (out or detections):
        raise typer.BadParameter("--out and --detections belong to one recording, on this machine; give one")
    if jobs is not None and dask is not None:
        raise typer.BadParameter("--jobs is of this machine, --dask of a cluster; choose")
    options_of_all: dict[str, Any] = {
        "frontend": frontend,
        "models": models,
        "assignments": assignments or [],
        "start": start,
        "end": end,
        "stride": stride,
        "jobs": jobs,
    }
    if len(recordings) > 1 or dask is not None:
        _several(recordings, options_of_all, dask, json)
        return
    from openvox.apps import perceive as application

    result = application.perceive(
        recordings[0], detections=detections, out=out, progress=progress("perceiving"), **options_of_all
    )
    other: tuple[str | Path, ...] = ("--perception", out) if out else ()
    tables.show(result, json, print_result, "openvox", "replay", recordings[0], *other)


def _several(recordings: list[Path], options_of_all: dict[str, Any], dask: str | None, json: bool) -> None:
    from openvox.apps import perceive_several as application

    found = application.perceive_several(
        recordings, dask=dask, progress=progress("perceiving", unit="recordings"), **options_of_all
    )
    results = [
        {"recording": str(recording), **({"error": result} if isinstance(result, str) else tables.plain(result))}
        for recording, result in zip(recordings, found.results, strict=True)
    ]
    whole = {"recordings": results, "seconds": found.seconds, "frames_per_second": found.frames_per_second}
    tables.show(whole, json, print_several)
    if any("error" in result for result in results):
        raise typer.Exit(3)


def print_result(data: tables.Data, before: str = "") -> None:
    """What was found, what of it was there already, and what ran. before: what the line begins with."""
    kinds = ", ".join(f"{count} {kind}s" for kind, count in data["kinds"].items())
    print(f"{before}{data['frames']} frames looked at, {data['masks']} masks ({kinds or 'none'}){_ran(data)}")
    tables.notes(data)
    if not data["untouched"]:
        tables.wrote(data["output"])


def _ran(data: tables.Data) -> str:
    """Of the stages only those that were run, and on how many frames unless on all."""
    encoded = (
        f"captions encoded by {data['encoder']}" if data["device"] else f"embeddings by {data['encoder']} as given"
    )
    makes = {"det": "boxes", "segcap": "masks", "enc": encoded}
    done = {role: frames for role, frames in data["computed"].items() if frames}
    if not done:
        return ""
    all_of_it = set(data["computed"].values()) == {data["frames"]}
    new = encoded if all_of_it else "new: " + ", ".join(f"{makes[role]} in {done[role]} frames" for role in done)
    where = f", models {data['device']}" if data["device"] else ""
    return f", {data['seconds']:.1f} s, {data['frames_per_second']:.1f} frames/s, {new}{where}"


def print_several(data: tables.Data) -> None:
    """The same for each of several recordings, or why one failed, and how fast they were together."""
    for result in data["recordings"]:
        if "error" in result:
            print(f"openvox: {result['error']}", file=sys.stderr)
        else:
            print_result(result, f"{result['recording']}: ")
    done = sum("error" not in result for result in data["recordings"])
    rate = f", {data['frames_per_second']:.1f} frames/s" if data["frames_per_second"] else ""
    print(f"in all: {done} of {len(data['recordings'])} recordings, {data['seconds']:.1f} s{rate}")
