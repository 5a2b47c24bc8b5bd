"""`openvox evaluate`: a map against ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from openvox.cli import options, tables
from openvox.cli.progress import progress

EXAMPLES = (
    "openvox evaluate living.map.npz --truth scans/living",
    "openvox evaluate living.map.npz --truth living.mcap",
)


def evaluate(
    map_file: options.MapFile,
    truth: Annotated[Path, typer.Option(metavar="DIR|REC", help="Folder with gt_points.npz, or a recording.")],
    queries: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of the truth's queries.json.")] = None,
    classes: Annotated[
        Path | None, typer.Option(metavar="FILE", help="One name a line, in place of the truth's categories.")
    ] = None,
    models: options.AskingModels = None,
    json: options.Json = False,
) -> None:
    """Score a map against ground truth.

    Instances, confidence, rendered masks, semantics and retrieval; the objects that were split, merged or missed by
    name.
    """
    from openvox.apps import evaluate as application

    result = application.evaluate(
        map_file, truth=truth, queries=queries, classes=classes, models=models, progress=progress("rendering")
    )
    tables.show(result, json, print_result, "openvox", "query", map_file, "somewhere to sit")


MEASURES = ("ap", "ap50", "ap25", "f50", "miou", "spill", "missed_share", "wrong_share")


LABELLINGS = ("instances", "instances_in_voxel", "instances_authors_rule")


def print_result(data: tables.Data) -> None:
    """The scores, and by name the objects that were split, merged or missed."""
    tables.print_table(["labels", *MEASURES], [[name, *(data[name][m] for m in MEASURES)] for name in LABELLINGS])
    counts = data["instances"]
    print("  ".join(f"{name} {counts[name]}" for name in ("predicted", "true", "split", "merged", "missed")))
    troubled = [o for o in data["objects"] if o["missed"] or o["merged_with"] or len(o["split_into"]) > 1]
    if troubled:
        tables.print_table(
            ["id", "object", "best IoU", "split into", "merged with", "missed"],
            [[o["id"], o["name"], o["best_iou"], o["split_into"], o["merged_with"], o["missed"]] for o in troubled],
            "objects split, merged or missed",
        )
    for name in ("calibration", "rendered_masks", "semantics"):
        print(f"{name.replace('_', ' ')}  {tables.cell(data[name])}")
    for kind, found in (data["retrieval"] or {}).items():
        print(f"retrieval {kind}  {tables.cell(found)}")
    tables.notes(data)
