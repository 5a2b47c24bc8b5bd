"""Both presets on rooms with ground truth: speed, size and quality as a table in Markdown.

python tools/bench/scenes.py ../shared/data/dev_living ../shared/data/dev_bedroom
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

LEVELS = ("clean", "noisy", "hard")
PRESETS = ("paper", "openvox")
COLUMNS = (
    *("scene", "masks", "preset", "frames/s", "mapper ms", "voxels", "instances", "AP", "AP50", "f50"),
    *("spill", "missed", "merged", "R@1", "map digest"),
)


def openvox(*arguments: object) -> dict[str, Any]:
    command = [sys.executable, "-m", "openvox", *map(str, arguments), "--json"]
    result: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return result


def row(scene: Path, level: str, preset: str, folder: Path) -> tuple[str, ...]:
    recording = folder / f"{scene.name}.mcap"
    stem = folder / f"{scene.name}-{level}-{preset}"
    perception = folder / f"{scene.name}-{level}.perception.mcap"
    ran = openvox("replay", recording, "--perception", perception, "--preset", preset, "--out", stem)
    scored = openvox("evaluate", f"{stem}.map.npz", "--truth", scene)
    found = scored["instances"]
    ms = sum(ran["ms"][stage]["median"] for stage in ("masks", "project", "associate", "evolve"))
    return (
        *(scene.name, level, preset, f"{ran['frames_per_second']:.0f}", f"{ms:.1f}"),
        *(str(ran["voxels"]), f"{found['predicted']}/{found['true']}"),
        *(f"{found[name]:.3f}" for name in ("ap", "ap50", "f50", "spill", "missed_share")),
        *(str(found["merged"]), f"{scored['retrieval']['all']['r1']:.2f}", ran["digests"]["map"][:10]),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+", help="folders with detections_{clean,noisy,hard}.jsonl")
    scenes = parser.parse_args().scenes
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for scene in scenes:
            openvox("ingest", scene, folder / f"{scene.name}.mcap")
            for level in LEVELS:
                detections = scene / f"detections_{level}.jsonl"
                out = folder / f"{scene.name}-{level}.perception.mcap"
                openvox("perceive", folder / f"{scene.name}.mcap", "--detections", detections, "--out", out)
                for preset in PRESETS:
                    print("| " + " | ".join(row(scene, level, preset, folder)) + " |", flush=True)


if __name__ == "__main__":
    main()
