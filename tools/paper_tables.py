"""Runs the paper's eight Replica and six ScanNet scenes and prints tables 2 to 4 in Markdown, its figures beside ours.

tools/paper_tables --replica Replica --replica-truth replica_v1 --scannet scans --out runs
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

# Of each scene the paper's figures in percent: AP, AP50, AP25 (its table 2), mIoU, mAcc (table 3), all of OpenVox.
REPLICA = {
    "room_0": (17.55, 35.82, 52.53, 48.15, 62.16),
    "room_1": (11.94, 36.01, 54.11, 35.86, 57.66),
    "room_2": (16.37, 37.56, 52.36, 26.94, 42.74),
    "office_0": (6.36, 12.40, 20.01, 19.27, 36.32),
    "office_1": (9.47, 22.38, 32.33, 15.66, 26.76),
    "office_2": (10.43, 25.94, 32.44, 26.07, 43.19),
    "office_3": (9.53, 22.72, 32.75, 22.14, 38.39),
    "office_4": (12.21, 25.46, 31.13, 24.31, 40.16),
}
SCANNET = {
    "scene0011_01": (3.73, 11.80, 29.03, 33.57, 63.23),
    "scene0030_02": (2.02, 8.14, 21.94, 19.43, 45.43),
    "scene0220_02": (2.49, 7.64, 24.95, 27.51, 60.71),
    "scene0592_01": (3.70, 12.33, 34.30, 15.55, 53.47),
    "scene0673_04": (7.44, 22.61, 47.73, 27.60, 59.41),
    "scene0696_02": (2.81, 8.86, 29.26, 13.41, 43.15),
}
AVERAGES = {"Replica": (11.73, 27.29, 38.46, 27.30, 43.42), "ScanNet": (3.70, 11.90, 31.20, 22.84, 54.23)}
RETRIEVAL = {
    "ontology": (0.905, 0.952, 1.000, 21),
    "relevance": (0.762, 0.905, 0.905, 21),
    "functionality": (0.714, 0.857, 0.952, 21),
}
PROTOCOL = """Protocol of our figures (docs/evaluation.md): class-agnostic instances the ScanNet way, over all points of
the data set's own mesh, walls, floor and ceiling as background; semantics over all points, each instance takes the
category whose name is nearest to its feature; retrieval with the queries.json beside the truth. Figures marked with *
are the paper's, under another protocol (its front end, its classes, its queries, and points that its map reaches): they
stand beside for orientation and do not compare."""


def openvox(*arguments: object) -> dict[str, Any]:
    """The JSON of a command; what it says on stderr goes through."""
    command = [sys.executable, "-m", "openvox", *map(str, arguments), "--json"]
    result: dict[str, Any] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return result


def score(source: Path, truth: Path, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """What evaluate says of the scene's map; every step is kept in --out and not made twice."""
    recording = options.out / f"{name}.mcap"
    detections = options.detections / f"{name}.jsonl" if options.detections else None
    if not recording.exists():
        openvox("ingest", source, recording, "--stride", options.stride)
    openvox("perceive", recording, *(["--detections", detections] if detections else []))
    openvox("replay", recording, "--preset", options.preset)
    return openvox("evaluate", options.out / f"{name}.map.npz", "--truth", truth)


def places(options: argparse.Namespace) -> list[tuple[str, str, Path | None, Path]]:
    """Data set, scene, source if it is there, truth."""
    found: list[tuple[str, str, Path | None, Path]] = []
    for name in REPLICA:
        plain = name.replace("_", "")
        source = options.replica / plain if options.replica else None
        truth = (options.replica_truth or options.replica or Path()) / name
        found.append(("Replica", name, source if source and source.is_dir() else None, truth))
    for name in SCANNET:
        folder = options.scannet / name if options.scannet else Path(name)
        sens = folder / f"{name}.sens"
        source = sens if sens.is_file() else folder if (folder / "color").is_dir() else None
        found.append(("ScanNet", name, source, folder))
    return found


def percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.2f}"


def ours(result: dict[str, Any] | None) -> tuple[float | None, ...]:
    """AP, AP50, AP25, mIoU, mAcc of a scene; None where there is nothing."""
    if result is None:
        return (None,) * 5
    semantics = result["semantics"] or {"miou": None, "macc": None}
    return (*(result["instances"][key] for key in ("ap", "ap50", "ap25")), semantics["miou"], semantics["macc"])


def mean(rows: Sequence[tuple[float | None, ...]]) -> tuple[float | None, ...]:
    """Of each column over the rows that have it."""
    columns = [[value for value in column if value is not None] for column in zip(*rows, strict=True)]
    return tuple(sum(column) / len(column) if column else None for column in columns)


def table(title: str, names: Sequence[str], columns: slice, results: dict[str, dict[str, Any] | None]) -> list[str]:
    """One of tables 2 and 3."""
    head = ["Scene", *(f"{name} {whose}" for name in names for whose in ("ours", "paper*"))]
    lines = [f"## {title}", "", f"| {' | '.join(head)} |", "|---|" + "---:|" * (len(head) - 1)]
    for dataset, scenes in (("Replica", REPLICA), ("ScanNet", SCANNET)):
        rows = {name: ours(results.get(name)) for name in scenes}
        for name, figures in [*rows.items(), (f"average of {dataset}", mean(list(rows.values())))]:
            paper = scenes.get(name, AVERAGES[dataset])[columns]
            pairs = zip(figures[columns], paper, strict=True)
            cells = [text for mine, theirs in pairs for text in (percent(mine), f"{theirs:.2f}")]
            lines.append(f"| {name} | {' | '.join(cells)} |")
    return [*lines, ""]


def retrieval(results: dict[str, dict[str, Any] | None]) -> list[str]:
    """Table 4: recall over the queries of all scenes that have some."""
    lines = [
        "## Table 4: retrieval",
        "",
        "| type | method | R@1 | R@2 | R@3 | number |",
        "|---|---|---:|---:|---:|---:|",
    ]
    for kind, paper in RETRIEVAL.items():
        found = [(result or {}).get("retrieval") or {} for result in results.values()]
        parts = [one[kind] for one in found if one.get(kind) and one[kind]["n"]]
        number = sum(part["n"] for part in parts)
        recalls = [
            f"{sum(p[key] * p['n'] for p in parts) / number:.3f}" if number else "-" for key in ("r1", "r2", "r3")
        ]
        lines.append(f"| {kind} | ours | {' | '.join(recalls)} | {number} |")
        lines.append(f"| {kind} | paper* | {' | '.join(f'{value:.3f}' for value in paper[:3])} | {paper[3]} |")
    return [*lines, ""]


def main(words: Sequence[str] | None = None) -> str:
    """The page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--replica", type=Path, help="NICE-SLAM's renderings: room0, ..., office4")
    parser.add_argument("--replica-truth", type=Path, help="Replica itself: room_0/habitat/mesh_semantic.ply, ...")
    parser.add_argument("--scannet", type=Path, help="scene0011_01, ...: a .sens or the exported folder, and the truth")
    parser.add_argument(
        "--detections", type=Path, help="a folder of SCENE.jsonl of a front end; else what perceive does"
    )
    parser.add_argument("--preset", default="openvox", help="openvox (the default) or paper")
    parser.add_argument("--stride", type=int, default=10, help="every Nth frame (10)")
    parser.add_argument("--out", type=Path, default=Path("paper_tables"), help="where recordings and maps go")
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    results: dict[str, dict[str, Any] | None] = {}
    for _, name, source, truth in places(options):
        results[name] = None
        if source is None:
            print(f"{name}: not there, left out", file=sys.stderr)
        else:
            try:
                results[name] = score(source, truth, name, options)
            except subprocess.CalledProcessError as error:
                print(f"{name}: openvox {error.cmd[3]} failed", file=sys.stderr)
    lines = [f"Preset `{options.preset}`, every {options.stride}th frame.", "", PROTOCOL, ""]
    lines += table("Table 2: instances (%)", ("AP", "AP50", "AP25"), slice(0, 3), results)
    lines += table("Table 3: semantics (%)", ("mIoU", "mAcc"), slice(3, 5), results)
    return "\n".join([*lines, *retrieval(results)])


if __name__ == "__main__":
    print(main())
