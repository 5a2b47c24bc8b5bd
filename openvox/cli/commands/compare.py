"""`openvox compare`: two maps or two traces, and what the difference meant."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables

EXAMPLES = (
    "openvox compare living.map.npz coarse.map.npz --rerun differences.rrd",
    "openvox compare living.trace.mcap coarse.trace.mcap",
)
LISTED = 12
"""Rows of each sort in a table; --json has all."""
ALIKE = 0.75
"""Matched instances that overlap more are not listed."""


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A map or a trace made by replay or live.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one, of the same kind.")],
    rerun: Annotated[Path | None, typer.Option(metavar="OUT.rrd", help="Also draw both maps side by side.")] = None,
    json: options.Json = False,
) -> None:
    """Say whether two maps or traces are the same, where they part first, and what it meant.

    Exit code 3 where they differ. Instances are matched by the space that they share.
    """
    from openvox.apps import compare as application

    result = application.compare(a, b, rerun=rerun)
    tables.show(result, json, print_result)
    if not result["same"]:
        raise typer.Exit(3)


def print_result(data: tables.Data) -> None:
    """Same or not, parameters, the first difference, instances."""
    print(f"the two {data['kind']}s are {'the same' if data['same'] else 'not the same'}")
    sides = ("preset", "frames", "voxels", "voxel_size", "instances")
    if not data["same"]:
        digest = f"{data['kind']}_digest"
        print_sides = [[name, *(data[side][name] for name in sides), data[side][digest][:12]] for name, side in _AB]
        tables.print_table(["", *(name.replace("_", " ") for name in sides), "digest"], print_sides)
    changed = {**data["parameters"], **{name: _short(pair) for name, pair in data["inputs"].items()}}
    if changed:
        rows = [[name, _exact(pair["a"]), _exact(pair["b"])] for name, pair in changed.items()]
        tables.print_table(["what was set", "A", "B"], rows)
        if any(None in (pair["a"], pair["b"]) for pair in changed.values()):
            print("unknown: one of the files does not note it, as those of another version of openvox")
    _print_first(data)
    if data["instances"] is not None:
        _print_instances(data)
    tables.notes(data)
    if data["rerun"]:
        tables.wrote(data["rerun"])


_AB = (("A", "a"), ("B", "b"))


def _exact(value: object) -> str:
    """Every digit of a parameter counts."""
    return "unknown" if value is None else tables.cell(str(value) if isinstance(value, float) else value)


def _short(pair: tables.Data) -> tables.Data:
    return {side: digest and str(digest)[:12] for side, digest in pair.items()}


def _print_first(data: tables.Data) -> None:
    if data["kind"] == "map" and data["first_difference"]:
        first = data["first_difference"]
        row = "" if first["row"] is None else f"[{first['row']}]"
        print(f"first in the file: {first['field']}{row}")
    if data["first_decision"]:
        print(f"first number that differs: {_place(data['first_decision'])}")
    if data["first_outcome"]:
        print(f"first mask that went another way: {_place(data['first_outcome'])}")
    elif data["first_decision"]:
        print("every mask went the same way")


def _place(first: tables.Data) -> str:
    caption = f" ({tables.cell(first['caption'])})" if first["caption"] else ""
    mask = "" if first["mask"] is None else f", mask {first['mask']}{caption}"
    return f"frame {first['frame']}{mask}: {first['field']} {_value(first['a'])} in A, {_value(first['b'])} in B"


def _value(value: object) -> str:
    return f"{value:.6f}" if isinstance(value, float) else tables.cell(value)


def _print_instances(data: tables.Data) -> None:
    found = data["instances"]
    counts = ", ".join(f"{len(found[name])} {name}" for name in found)
    if data["agreement"] is not None:
        print(f"{data['agreement']:.1%} of the voxels in A's instances lie in the same instance of B")
    print(f"instances: {len(data['matches'])} matched; {counts}")
    of_a = {row["a"]: row for row in data["matches"]}
    renamed = [of_a[i] for i in found["renamed"]]
    rows = [
        *_first_of([[_one(row["a"]), "split", _several(row["b"])] for row in data["split_into"]], "split"),
        *_first_of([[_several(row["a"]), "merged", _one(row["b"])] for row in data["merged_into"]], "merged"),
        *_first_of([[_one(row), "vanished", ""] for row in _largest(data["vanished"])], "vanished"),
        *_first_of([["", "appeared", _one(row)] for row in _largest(data["appeared"])], "appeared"),
        *_first_of(
            [[f"{m['a']} {m['a_caption']}", "renamed", f"{m['b']} {m['b_caption']}"] for m in renamed], "renamed"
        ),
    ]
    if rows:
        tables.print_table(["in A (voxels)", "", "in B (voxels)"], rows)
    worst = sorted((row for row in data["matches"] if row["iou"] < ALIKE), key=lambda row: (row["iou"], row["a"]))
    if worst:
        columns = ["A", "caption", "voxels", "B", "voxels", "IoU"]
        cells = [[m["a"], m["a_caption"], m["a_voxels"], m["b"], m["b_voxels"], m["iou"]] for m in worst[:LISTED]]
        tables.print_table(columns, cells, "matched, but least alike")
        if len(worst) > LISTED:
            print(f"... and {len(worst) - LISTED} more; --json has all")


def _first_of(rows: list[list[str]], what: str) -> list[list[str]]:
    more = len(rows) - LISTED
    return rows if more <= 0 else [*rows[:LISTED], ["", f"... and {more} more {what}", ""]]


def _largest(rows: list[tables.Data]) -> list[tables.Data]:
    return sorted(rows, key=lambda row: (-row["voxels"], row["instance"]))


def _several(rows: list[tables.Data]) -> str:
    """The named ones, the first of many."""
    more = len(rows) - LISTED
    return ", ".join(map(_one, rows[:LISTED])) + (f" and {more} more" if more > 0 else "")


def _one(row: tables.Data) -> str:
    return f"{row['instance']} {row['caption']} ({row['voxels']})"
