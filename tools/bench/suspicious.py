"""How often `explain --suspicious` is right, against random order, as a table in Markdown.

python tools/bench/suspicious.py --truth ../shared/data/dev_living living-hard.map.npz living-noisy.map.npz

Each map needs its trace beside it, and its recording (with truth pictures) and perception where it names them. A
decision is wrong if the main true object of its mask is not that of the instance to which it belongs in the end. A
mask's main true object has most of its pixels, an instance's has most of the true points that it labels (most pixels
of its masks, if it labels none); where that is under a quarter, it is background.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openvox.apps.explaining.run import Run, read_run
from openvox.apps.explaining.suspicious import suspicious
from openvox.apps.scoring.labels import labels_of_rows, rows_at_points
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import SUFFIX, read_map
from openvox.formats.perception import read_masks
from openvox.formats.recording import read_frames
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.truth import Truth, read_truth

LEAST = 4
"""One part in so many must be the main object, else it is background."""
Counts = NDArray[np.int64]


def main_object(counts: Counts) -> int:
    """The object with most of it, 0 = background. counts: by true id."""
    best = int(counts[1:].argmax()) + 1 if len(counts) > 1 else 0
    return best if best and LEAST * counts[best] >= counts.sum() and counts[best] else 0


def pixels_of_masks(recording: Path, perception: Path, ids: int) -> dict[tuple[int, int], Counts]:
    """Pixels by true id under each (frame, mask)."""
    found = {one.index: one.masks for one in read_masks(perception)}
    out = {}
    for frame in read_frames(recording, truth=True):
        assert frame.truth_instances is not None, f"{recording} has no truth"
        for m, mask in enumerate(found.get(frame.index, ())):
            x0, y0, x1, y1 = mask.box
            out[frame.index, m] = np.bincount(frame.truth_instances[y0:y1, x0:x1][mask.crop()], minlength=ids)
    return out


def main_objects(result: InstanceMap, truth: Truth, ids: int) -> dict[int, int]:
    """Main true object of every instance that labels a true point."""
    labels = labels_of_rows(rows_at_points(truth.points, result), result)
    return {
        instance: main_object(np.bincount(truth.instance[labels == instance], minlength=ids))
        for instance in np.unique(labels[labels > 0]).tolist()
    }


def wrong(run: Run, pixels: dict[tuple[int, int], Counts], known: dict[int, int]) -> dict[tuple[int, int], bool]:
    """Whether each decision is an error."""
    sums: dict[int, Counts] = {}
    where = {}
    for position, row in run.decisions():
        key, instance = (run.frames[position].frame, row["mask"]), run.final[row["fragment"]]
        where[key] = instance
        sums[instance] = sums.get(instance, np.zeros_like(pixels[key])) + pixels[key]
    main = {instance: known.get(instance, main_object(counts)) for instance, counts in sums.items()}
    return {key: main_object(pixels[key]) != main[instance] for key, instance in where.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--truth", type=Path, required=True, help="the folder with gt_points.npz")
    parser.add_argument("maps", type=Path, nargs="+", help="STEM.map.npz")
    arguments = parser.parse_args()
    truth = read_truth(arguments.truth)
    ids = int(truth.instance.max()) + 1
    columns = ("run", "decisions", "wrong", "random", "right of 10", "right of 20", "instances in the 20")
    print(f"| {' | '.join(columns)} |\n" + "|---" * len(columns) + "|")
    for path in arguments.maps:
        result = read_map(path)
        run = read_run(path.with_name(path.name.removesuffix(SUFFIX) + TRACE_SUFFIX))
        recording, perception = (path.parent / str(result.meta[name]) for name in ("recording", "perception"))
        errors = wrong(run, pixels_of_masks(recording, perception, ids), main_objects(result, truth, ids))
        listed = suspicious(run, 20)["decisions"]
        hits = [errors[one["frame"], one["mask"]] for one in listed]
        spread = len(Counter(one["instance"] for one in listed))
        share = sum(errors.values()) / len(errors)
        figures = (f"{share:.3f}", f"{sum(hits[:10]) / 10:.2f}", f"{sum(hits) / 20:.2f}", spread)
        words = (path.name.removesuffix(SUFFIX), len(errors), sum(errors.values()), *figures)
        print(f"| {' | '.join(map(str, words))} |", flush=True)


if __name__ == "__main__":
    main()
