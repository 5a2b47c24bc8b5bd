"""What is aimed at, and what the authors' choices give on the same masks: means over scenes and seeds, in Markdown.

python tools/bench/aims.py ../shared/data/dev_living ../shared/data/dev_bedroom --seeds 0,1,2
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ablation import mapped, perceived, points_alone

from openvox.apps.ingest import ingest
from openvox.apps.perceive import perceive

LEVELS = ("clean", "noisy", "hard")
KINDS = ("ontology", "relevance", "functionality")
VARIANTS = (
    ("paper", "paper", ()),
    ("official", "official", ()),
    ("official, ranked by frames matched", "official", ("finish.ranking=matches",)),
    ("official, veto, ranked by frames matched", "official", ("finish.ranking=matches", "evolution.veto=true")),
    ("openvox", "openvox", ()),
)


def mean(runs: Sequence[dict[str, Any]], *names: str) -> float:
    """The mean of one figure, found by its path."""
    total = 0.0
    for run in runs:
        value: Any = run
        for name in names:
            value = value[name]
        total += float(value or 0)
    return total / len(runs)


def every_fifth(scene: Path, perception: Path, folder: Path) -> Path:
    """The perception of every fifth frame, from the same detections."""
    out = folder / "fifth.perception.mcap"
    out.unlink(missing_ok=True)
    detections = perception.with_suffix(".jsonl")
    perceive(folder / f"{scene.name}.mcap", detections=detections, out=out, stride=5)
    return out


def aims(files: dict[str, list[tuple[Path, Path]]], folder: Path) -> None:
    """A row a figure, a column a kind of masks."""
    rows: dict[str, list[str]] = {}
    for level in LEVELS:
        runs = [mapped(scene, file, scene, folder) for scene, file in files[level]]
        fifth = [
            mapped(scene, every_fifth(scene, file, folder), points_alone(scene, folder), folder)
            for scene, file in files[level]
        ]
        for label, name in (
            ("AP", "ap"),
            ("AP50", "ap50"),
            ("f50", "f50"),
            ("spill", "spill"),
            ("missed", "missed_share"),
        ):
            rows.setdefault(label, []).append(f"{mean(runs, 'instances', name):.3f}")
        rows.setdefault("welded objects a room", []).append(f"{mean(runs, 'instances', 'merged'):.1f}")
        share = mean(runs, "instances", "predicted") / mean(runs, "instances", "true")
        rows.setdefault("instances / true", []).append(f"{share:.2f}")
        rows.setdefault("AP50, every 5th frame", []).append(f"{mean(fifth, 'instances', 'ap50'):.3f}")
        words = " / ".join(f"{mean(runs, 'retrieval', kind, 'r1'):.2f}" for kind in KINDS)
        rows.setdefault("R@1 ontology / relevance / functionality", []).append(words)
        semantics = " / ".join(f"{mean(runs, 'semantics', name):.2f}" for name in ("miou", "macc"))
        rows.setdefault("semantic mIoU / mAcc, all points", []).append(semantics)
        masks = f"{mean(runs, 'rendered_masks', 'iou'):.2f} ({mean(runs, 'rendered_masks', 'detected_iou'):.2f})"
        rows.setdefault("rendered masks, best IoU (detections)", []).append(masks)
    print("| | true masks | noisy | hard |\n|---|---|---|---|")
    for label, cells in rows.items():
        print(f"| {label} | " + " | ".join(cells) + " |", flush=True)


def comparison(files: dict[str, list[tuple[Path, Path]]], folder: Path) -> None:
    """A row a kind of masks and a variant; the last two columns with labels from the containing voxel only."""
    columns = (
        "masks",
        "mapper",
        "AP",
        "AP50",
        "f50",
        "spill",
        "missed",
        "welded",
        "instances",
        "AP50 in voxel",
        "spill in voxel",
    )
    print("\n| " + " | ".join(columns) + " |\n" + "|---" * len(columns) + "|")
    for level in LEVELS:
        for label, preset, rules in VARIANTS:
            runs = [mapped(s, file, points_alone(s, folder), folder, preset, rules) for s, file in files[level]]
            near = " | ".join(
                f"{mean(runs, 'instances', n):.3f}" for n in ("ap", "ap50", "f50", "spill", "missed_share")
            )
            counts = " | ".join(f"{mean(runs, 'instances', n):.1f}" for n in ("merged", "predicted"))
            inside = " | ".join(f"{mean(runs, 'instances_in_voxel', n):.3f}" for n in ("ap50", "spill"))
            print(f"| {level} | {label} | {near} | {counts} | {inside} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+", help="folders with a simulate_detections.py beside them")
    parser.add_argument("--seeds", default="0,1,2")
    chosen = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        for scene in chosen.scenes:
            ingest(scene, folder / f"{scene.name}.mcap")
        files = {
            level: [
                (scene, perceived(scene, level, int(seed), folder))
                for scene in chosen.scenes
                for seed in chosen.seeds.split(",")
            ]
            for level in LEVELS
        }
        aims(files, folder)
        comparison(files, folder)


if __name__ == "__main__":
    main()
