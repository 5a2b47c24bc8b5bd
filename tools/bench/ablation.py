"""What each rule of preset openvox does: the mean over rooms and seeds, one rule changed a row, as a table in Markdown.

python tools/bench/ablation.py ../shared/data/dev_living ../shared/data/dev_bedroom --seeds 0,1,2 --levels noisy,hard

Detections are simulated by the scenes' own simulate_detections.py; `--masks FRONTEND` takes those of a
front end that ships instead, which no simulator made. Any number of `--set K=V,K=V` replaces the built-in rows.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from openvox.apps.evaluate import evaluate
from openvox.apps.ingest import ingest
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay

RULES = (
    "",
    "association.containment=false",
    "association.hidden_evidence=1",
    "evolution.background=false",
    "evolution.voxel_votes=false",
    "evolution.abstention=false",
    "evolution.cut=false",
    "evolution.cut_inheritance=2",
    "evolution.cut_least=0",
    "evolution.near=0",
    "lifecycle.evidence=false",
    "lifecycle.omission=0",
    "lifecycle.captions=false",
    "lifecycle.halving=0",
    "lifecycle.kinds=false",
    "lifecycle.colors=false",
    "lifecycle.clear_pixels=0",
    "finish.smoothing=0",
    "finish.rounds=0",
    "finish.holes=0",
    "finish.existence=false",
    "finish.brief=false",
    "finish.ranking=existence",
    "masks.erosion=0,masks.step_margin=0",
)
MEASURES = ("ap", "ap50", "ap25", "f50", "spill", "missed_share", "predicted", "merged")


def perceived(scene: Path, level: str, seed: int, folder: Path) -> Path:
    """The perception file of simulated detections; of a front end if the level is one."""
    out = folder / f"{scene.name}-{level}-{seed}.perception.mcap"
    if level in ("clean", "noisy", "hard"):
        detections = out.with_suffix(".jsonl")
        command = [
            sys.executable,
            scene.parent / "simulate_detections.py",
            scene,
            "--level",
            level,
            "--seed",
            str(seed),
        ]
        with detections.open("w") as file:
            subprocess.run(command, check=True, stdout=file, stderr=subprocess.DEVNULL)
        perceive(folder / f"{scene.name}.mcap", detections=detections, out=out)
    else:
        perceive(folder / f"{scene.name}.mcap", frontend=level, out=out)
    return out


def points_alone(scene: Path, folder: Path) -> Path:
    """The scene's truth without its pictures: the masks that they would be compared with are most of the time."""
    bare = folder / f"{scene.name}-truth"
    bare.mkdir(exist_ok=True)
    for name in ("gt_points.npz", "objects.json", "queries.json"):
        if not (bare / name).exists():
            (bare / name).symlink_to((scene / name).resolve())
    return bare


def mapped(
    scene: Path, perception: Path, truth: Path, folder: Path, preset: str = "openvox", rules: Sequence[str] = ()
) -> dict[str, Any]:
    """What `evaluate` says of the map."""
    stem = folder / "run"
    replay(folder / f"{scene.name}.mcap", perception=perception, preset_name=preset, assignments=rules, out=str(stem))
    return evaluate(Path(f"{stem}.map.npz"), truth=truth)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--levels", default="noisy,hard")
    parser.add_argument("--masks", help="a front end, as geometry or offline, in place of simulated levels")
    parser.add_argument("--preset", default="openvox")
    parser.add_argument("--set", dest="rules", action="append")
    chosen = parser.parse_args()
    levels = [chosen.masks] if chosen.masks else chosen.levels.split(",")
    seeds = [0] if chosen.masks else [int(text) for text in chosen.seeds.split(",")]
    print(f"| masks | parameters | {' | '.join(MEASURES)} |\n" + "|---" * (len(MEASURES) + 2) + "|")
    with TemporaryDirectory() as name:
        folder = Path(name)
        for scene in chosen.scenes:
            ingest(scene, folder / f"{scene.name}.mcap")
        for level in levels:
            files = [(scene, perceived(scene, level, seed, folder)) for scene in chosen.scenes for seed in seeds]
            for rule in chosen.rules or RULES:
                rules = [text for text in rule.split(",") if text]
                runs = [
                    mapped(scene, file, points_alone(scene, folder), folder, chosen.preset, rules)["instances"]
                    for scene, file in files
                ]
                means = (sum(run[measure] for run in runs) / len(runs) for measure in MEASURES)
                cells = " | ".join(f"{mean:.3f}" for mean in means)
                print(f"| {level} | `{rule or 'all rules'}` | {cells} |", flush=True)


if __name__ == "__main__":
    main()
