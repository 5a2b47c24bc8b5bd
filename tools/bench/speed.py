"""Speed and size of the mapper, as ratios: engines by stage, growth with the map, replay as a share of decoding.

python tools/bench/speed.py recordings/living_demo.mcap [--tiles 1 8 80]

The growing world is the recording again and again, each time 100 m further on; what is timed is always the first
place, so that the frames and what they see stay the same and only the map around them grows.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from openvox.apps.replay import Stopwatch, replay, warm_up
from openvox.core.mapper_parameters import OPENVOX
from openvox.core.types import Frame, Mask, Pose
from openvox.formats.perception import SUFFIX, read_masks
from openvox.formats.recording import read_frames
from openvox.mapper.mapper import Mapper

STAGES = ("masks", "project", "associate", "evolve")
Items = Sequence[tuple[Frame, tuple[Mask, ...]]]


def timed(items: Items, mapper: Mapper, watch: Stopwatch) -> dict[str, np.ndarray]:
    """Milliseconds of each stage and of whole steps, one a frame."""
    watch.times = {}
    for frame, masks in items:
        mapper.step(frame, masks)
    stages = {name: np.array(watch.times[name]) for name in STAGES}
    return {**stages, "step": np.sum(list(stages.values()), axis=0)}


def shifted(items: Items, metres: float, first: int) -> Items:
    out = []
    for n, (frame, masks) in enumerate(items):
        x, y, z = frame.world_from_depth.translation
        pose = Pose(frame.world_from_depth.quaternion, (x + metres, y, z))
        out.append((replace(frame, index=first + n, world_from_depth=pose), masks))
    return out


def engines(items: Items) -> None:
    print("| engine | " + " | ".join(f"{name} ms" for name in (*STAGES, "step")) + " | to cpu |\n" + "|---" * 7 + "|")
    names = ["cpu", *(["torch"] if importlib.util.find_spec("torch") else [])]
    reference = 0.0
    for name in names:
        warm_up(OPENVOX, name, print)
        watch = Stopwatch()
        found = timed(items, Mapper(OPENVOX, watch, name), watch)
        median = float(np.median(found["step"]))
        reference = reference or median
        cells = [f"{np.median(found[stage]):.2f} / {np.percentile(found[stage], 95):.2f}" for stage in found]
        print(f"| {name} | " + " | ".join(cells) + f" | {median / reference:.1f} |", flush=True)


def growth(items: Items, tiles: Sequence[int]) -> None:
    print(
        "\n| voxels | fragments | step ms, median / p95 | to the first | longest step | bytes a voxel |\n"
        + "|---" * 6
        + "|"
    )
    watch = Stopwatch()
    mapper = Mapper(OPENVOX, watch)
    first, number, longest = 0.0, 0, 0.0
    numbers = itertools.count()
    for size in sorted(tiles):
        while number < size:
            tile = shifted(items[:: 1 if number == 0 else 4], 100.0 * number, next(numbers) * len(items))
            longest = max(longest, float(timed(tile, mapper, watch)["step"].max()))
            number += 1
        again = shifted(items[1::3], 0.0, next(numbers) * len(items))
        found = timed(again, mapper, watch)["step"]
        median, voxels = float(np.median(found)), mapper.voxels
        first = first or median
        print(
            f"| {voxels} | {mapper.fragments} | {median:.2f} / {np.percentile(found, 95):.2f} | {median / first:.2f} "
            f"| {longest:.0f} | {mapper.bytes / voxels:.1f} |",
            flush=True,
        )


def end_to_end(recording: Path, out: Path) -> None:
    begin = time.perf_counter()
    frames = sum(1 for _ in read_frames(recording, truth=False))
    masks = sum(1 for _ in read_masks(recording.with_suffix(SUFFIX)))
    decoding = time.perf_counter() - begin
    seconds = replay(recording, out=str(out))["seconds"]
    speed, share = frames / seconds, seconds / decoding
    print(f"\nreplay of {frames} frames ({masks} with masks): {speed:.0f} frames/s, {share:.2f} x decoding alone")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, help="with its perception beside it")
    parser.add_argument("--tiles", type=int, nargs="+", default=[1, 8, 80], help="visits to new places, for the growth")
    parser.add_argument("--out", type=Path, default=Path("/tmp/openvox-bench"), help="stem for the map of the replay")
    arguments = parser.parse_args()
    known = {found.index: found.masks for found in read_masks(arguments.recording.with_suffix(SUFFIX))}
    items = [(frame, known[frame.index]) for frame in read_frames(arguments.recording, truth=False)]
    engines(items)
    end_to_end(arguments.recording, arguments.out)
    growth(items, arguments.tiles)


if __name__ == "__main__":
    main()
