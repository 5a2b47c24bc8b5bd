"""What a front end finds in rooms with ground truth: regions, words, the whole chain, speed; tables in Markdown.

python tools/bench/frontend.py ../shared/data/dev_living ../shared/data/dev_bedroom --frontend offline
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from openvox.apps.scoring.instances import Overlaps
from openvox.apps.scoring.labels import labels_of_rows, rows_at_points
from openvox.core.types import Frame, Mask
from openvox.formats.map_npz import read_map
from openvox.formats.perception import read_masks
from openvox.formats.recording import read_frames, recording_info
from openvox.formats.truth import read_truth

VISIBLE = 1000
SIZES = (4000, 20000)
STRIDE = 5
SYNONYMS = json.loads(Path(__file__).with_name("synonyms.json").read_text())
"""Category of the truth: nouns that are right for it, as fixed by hand before the first run."""


def openvox(*arguments: object) -> dict[str, Any]:
    command = [sys.executable, "-m", "openvox", *map(str, arguments), "--json"]
    result: dict[str, Any] = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return result


def regions(recording: Path, perception: Path) -> tuple[str, ...]:
    """Recall at IoU 0.5 of visible objects, by size; and words right, wrong, missing."""
    categories = recording_info(recording).categories
    best: list[tuple[int, float]] = []
    count: Counter[str] = Counter()
    masks = useless = frames = 0
    found = {one.index: one.masks for one in read_masks(perception)}
    for frame in read_frames(recording, stride=STRIDE):
        if frame.index in found:
            fits = overlaps(frame, found[frame.index])
            frames += 1
            masks += len(found[frame.index])
            useless += int((fits.max(1, initial=0) < 0.5).sum())
            best += objects(frame, found[frame.index], fits, categories, count)
    size, iou = np.array(best).T
    hit = iou >= 0.5
    bands = [hit[(size >= low) & (size < high)].mean() for low, high in zip((0, *SIZES), (*SIZES, 1e9), strict=True)]
    seen = len(best)
    given = count["right"] + count["wrong"]
    return (
        *(f"{hit.mean():.3f}", f"{iou.mean():.3f}", " ".join(f"{band:.2f}" for band in bands)),
        *(f"{masks / frames:.1f} ({useless / frames:.1f})", f"{count['right'] / seen:.3f}"),
        *(f"{count['right'] / max(1, given):.3f}", f"{1 - given / seen:.3f}", f"{count['elsewhere'] / frames:.1f}"),
    )


def overlaps(frame: Frame, masks: Iterable[Mask]) -> np.ndarray:
    """(masks, objects visible) IoU; the objects by number, as `visible` says."""
    truth = frame.truth_instances
    assert truth is not None
    area = np.bincount(truth.reshape(-1))
    rows = []
    for mask in masks:
        x0, y0, x1, y1 = mask.box
        common = np.bincount(truth[y0:y1, x0:x1][mask.crop()], minlength=len(area))
        rows.append((common / (area + mask.area - common))[visible(frame)])
    return np.array(rows).reshape(len(rows), len(visible(frame)))


def visible(frame: Frame) -> np.ndarray:
    area = np.bincount(frame.truth_instances.reshape(-1))  # type: ignore[union-attr]
    area[0] = 0
    return np.flatnonzero(area >= VISIBLE)


def objects(
    frame: Frame, masks: tuple[Mask, ...], fits: np.ndarray, categories: Any, count: Counter[str]
) -> list[tuple[int, float]]:
    """Size and best IoU of each visible object. A word is the object's if its mask fits; others are counted apart."""
    out = []
    used = set()
    for column, number in enumerate(visible(frame).tolist()):
        where = frame.truth_instances == number
        category = categories[int(np.bincount(frame.truth_categories[where]).argmax())]  # type: ignore[index]
        out.append((int(where.sum()), float(fits[:, column].max(initial=0))))
        good = [i for i in np.argsort(-fits[:, column], kind="stable") if fits[i, column] >= 0.5]
        used.update(good)
        words = [masks[i].label for i in good if masks[i].named]
        if words:
            count["right" if words[0] in SYNONYMS[category] else "wrong"] += 1
    count["elsewhere"] += sum(mask.named for i, mask in enumerate(masks) if i not in used)
    return out


def names(map_file: Path, scene: Path, weight: Counter[int]) -> tuple[str, str]:
    """Share of what is visible (an object once in each frame) whose instance in the map is named rightly, and of those
    named at all. An object's instance is that of the highest IoU, above 0.25. weight: frames in which an object is."""
    result, truth = read_map(map_file), read_truth(scene, None)
    overlaps = Overlaps.count(truth.instance, labels_of_rows(rows_at_points(truth.points, result), result))
    called = {one.id: one.caption if one.named else "" for one in result.instances}
    count: Counter[str] = Counter()
    for number, iou in zip(overlaps.true_ids.tolist(), overlaps.iou(), strict=True):
        best = int(iou.argmax())
        caption = called[int(overlaps.ids[best])] if iou[best] > 0.25 else ""
        category = truth.categories[int(np.bincount(truth.category[truth.instance == number]).argmax())]
        right = any(caption.endswith(f" {word}") for word in SYNONYMS.get(category, ()))
        count["right" if right else "wrong" if caption else "none"] += weight[number]
    return f"{count['right'] / count.total():.2f}", f"{count['right'] / max(1, count['right'] + count['wrong']):.2f}"


def seen(recording: Path) -> Counter[int]:
    """In how many frames each object is visible."""
    return Counter(number for frame in read_frames(recording, stride=STRIDE) for number in visible(frame).tolist())


def chain(recording: Path, perception: Path, scene: Path, preset: str, nouns: bool) -> tuple[str, ...]:
    """Mapped and scored. nouns: captions are "a COLOUR NOUN", so that names can be looked up."""
    with tempfile.TemporaryDirectory() as name:
        stem = Path(name) / "run"
        openvox("replay", recording, "--perception", perception, "--preset", preset, "--out", stem)
        scored = openvox("evaluate", f"{stem}.map.npz", "--truth", scene)
        named = names(Path(f"{stem}.map.npz"), scene, seen(recording)) if nouns else ("", "")
    found, recall = scored["instances"], scored["retrieval"]["all"]
    return (
        *(f"{found[key]:.3f}" for key in ("ap", "ap50", "ap25", "f50", "miou", "spill", "missed_share")),
        *(f"{found['predicted']}/{found['true']}", str(found["split"]), str(found["merged"])),
        *(f"{recall[key]:.2f}" for key in ("r1", "r2", "r3")),
        *(f"{scored['retrieval'][key]['r1']:.2f}" for key in ("ontology", "relevance", "functionality")),
        *named,
    )


REGIONS = ("room", "R@.5", "IoU", "by size", "masks (useless)", "right", "right of given", "missing", "elsewhere")
CHAIN = (
    *("room", "masks", "preset", "AP", "AP50", "AP25", "f50", "mIoU", "spill", "missed", "instances", "split"),
    *("merged", "R@1", "R@2", "R@3", "ont.", "rel.", "func.", "named right", "of named"),
)


def table(columns: Iterable[str], rows: Iterable[tuple[str, ...]]) -> None:
    columns = list(columns)
    print("\n| " + " | ".join(columns) + " |\n" + "|---" * len(columns) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", type=Path, nargs="+", help="folders with truth and detections_noisy.jsonl")
    parser.add_argument("--frontend", default="offline")
    parser.add_argument("--set", action="append", default=[], metavar="K=V")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="recordings and perception files are kept there")
    parser.add_argument("--regions-only", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = options.keep or Path(name)
        made = [files(scene, folder, options) for scene in options.scenes]
        table(REGIONS, ((scene.name, *regions(*made[i][:2])) for i, scene in enumerate(options.scenes)))
        if options.regions_only:
            return
        table(
            CHAIN,
            (
                (scene.name, kind, preset, *chain(recording, perception, scene, preset, kind != "noisy"))
                for scene, (recording, own, noisy) in zip(options.scenes, made, strict=True)
                for kind, perception, preset in ((options.frontend, own, "openvox"), ("noisy", noisy, "openvox"))
            ),
        )


def files(scene: Path, folder: Path, options: argparse.Namespace) -> tuple[Path, Path, Path]:
    """Recording, what the front end finds in it, what the simulated detector finds."""
    recording = folder / f"{scene.name}.mcap"
    own, noisy = (folder / f"{scene.name}-{kind}.perception.mcap" for kind in (options.frontend, "noisy"))
    if not recording.exists():
        openvox("ingest", scene, recording)
    own.unlink(missing_ok=True)  # else what it holds would be taken over, and nothing measured
    settings = [word for value in options.set for word in ("--set", value)]
    every = ("--stride", STRIDE) if options.regions_only else ()
    ran = openvox("perceive", recording, "--frontend", options.frontend, "--out", own, *settings, *every)
    print(f"{scene.name}: {ran['frames']} frames, {ran['frames_per_second']:.1f} a second", file=sys.stderr)
    if not noisy.exists() and not options.regions_only:
        openvox("perceive", recording, "--detections", scene / "detections_noisy.jsonl", "--out", noisy)
    return recording, own, noisy


if __name__ == "__main__":
    main()
