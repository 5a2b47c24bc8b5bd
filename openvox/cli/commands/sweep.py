"""`openvox sweep`: many parameter sets over many recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox sweep living.mcap --set association.threshold=0.2,0.3,0.4 --truth scans/living --out thresholds",
    "openvox sweep a.mcap b.mcap --set map.voxel_size=0.03,0.05 --set masks.erosion=1,2 --truth a --truth b --out grid",
    "openvox sweep /data/*.mcap --set masks.erosion=0,1,2 --dask tcp://10.0.0.5:8786 --out /data/erosion",
)
LISTED = 12
"""Sets in the table; the files have all."""
SCORES = ("ap", "ap50", "f50", "spill")


def sweep(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC.mcap...", help="Recordings with perception.")],
    assignments: Annotated[
        list[str], typer.Option("--set", metavar="K=V1,V2,...", help="A parameter and its values; may be repeated.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for maps, traces and results.")],
    truth: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR|REC", help="To score against: one for all, or one for each recording in order."),
    ] = None,
    perception: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Instead of STEM.perception.mcap, one for each recording in order."),
    ] = None,
    preset: Annotated[
        Literal["openvox", "official", "paper"], typer.Option(help="The parameters that are not swept.")
    ] = "openvox",
    params: options.Params = None,
    engine: options.Engine = "cpu",
    jobs: Annotated[int | None, typer.Option(min=1, metavar="N", help="Processes; as many as cores if absent.")] = None,
    dask: options.Dask = None,
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    json: options.Json = False,
) -> None:
    """Map recordings with every combination of parameter values, and say which parameter matters.

    What is already in the folder is not mapped again. Exit code 3 if some items failed.
    """
    if jobs is not None and dask is not None:
        raise typer.BadParameter("--jobs is of this machine, --dask of a cluster; choose")
    from openvox.apps import sweep as application

    result = application.sweep(
        recordings,
        assignments=assignments,
        out=out,
        perceptions=perception or [],
        truths=truth or [],
        preset_name=preset,
        params=params,
        engine=engine,
        jobs=jobs,
        dask=dask,
        start=start,
        end=end,
        stride=stride,
        progress=progress("sweeping", "items"),
        notice=lambda text: typer.echo(text, err=True),
    )
    tables.show(result, json, print_result)
    if result["failed"]:
        raise typer.Exit(3)


def print_result(data: tables.Data) -> None:
    """The best sets, what each parameter does, failures, files."""
    print(
        f"{len(data['items'])} items ({len(data['sets'])} sets, {len(data['recordings'])} recordings) in "
        f"{data['seconds']:.1f} s, {data['jobs']} at a time; {data['reused']} were there, {data['failed']} failed"
    )
    names = list(data["varied"])
    ranked = sorted(data["sets"], key=lambda one: (-((one["scores"] or {}).get("ap") or 0.0), one["set"]))
    scores = SCORES if data["measure"] else ()
    tables.print_table(
        ["set", *names, *scores, "instances", "seconds", "first other decision"],
        [
            [
                f"{one['set']}{' (default)' if one['default'] else ''}",
                *(str(one["parameters"][name]) for name in names),
                *((one["scores"] or {}).get(score) for score in scores),
                *(one["instances"], one["seconds"]),
                _first(data, one["set"]),
            ]
            for one in ranked[:LISTED]
        ],
        _title(len(ranked), bool(data["measure"])),
    )
    if data["best"] and data["best"]["ties"]:
        print(f"as good as set {data['best']['set']} (less than 0.001 behind): {_sets(data['best']['ties'])}")
    for effect in data["effects"]:
        if effect["measure"] in ("ap", "instances"):
            means = ", ".join(f"{m['value']}: {tables.cell(m['mean'])}" for m in effect["means"])
            print(f"{effect['parameter']} on {effect['measure']}: {means}")
    for item in data["items"]:
        if item["error"]:
            print(f"item {item['item']} ({item['recording']}, set {item['set']}) failed: {tables.cell(item['error'])}")
    tables.notes(data)
    for path in data["outputs"].values():
        if path:
            print(f"wrote {path}")


def _title(sets: int, scored: bool) -> str:
    order = "the best first" if scored else "in no order: without --truth nothing says which set is better"
    return f"means over the recordings, {order}" + (f"; {LISTED} of {sets}" if sets > LISTED else "")


def _sets(numbers: list[int]) -> str:
    more = len(numbers) - LISTED
    return f"set {', '.join(map(str, numbers[:LISTED]))}" + (f" and {more} more" if more > 0 else "")


def _first(data: tables.Data, number: int) -> str:
    """Where the set first parts from the default, in the first recording in which it does."""
    for item in data["items"]:
        first = item["first_outcome"]
        if item["set"] == number and first is not None:
            mask = "" if first["mask"] is None else f", mask {first['mask']}"
            return f"{item['recording']} frame {first['frame']}{mask}: {first['field']}"
    return ""
