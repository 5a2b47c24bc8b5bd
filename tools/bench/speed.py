"""Speed and size of the mapper, as ratios: engines by stage, growth with the map, replay as a share of decoding.

python tools/bench/speed.py recordings/living_demo.mcap [--tiles 1 11 130] [--walls 3 30 300]

Times are CPU time of the mapping thread, so that other work on the machine counts little; that of replay is both.
Engine "numpy" is the mapper over plain numpy (tools/bench/plain.py; masks are still painted by numba), to compare with.
The growing world is the recording again and again, each time 100 m further on, or walls of a hundred things each; what
is timed is always the first place, so that the frames and what they see stay the same and only the map around grows.
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from plain import with_numpy

from openvox.apps.replay import replay, warm_up
from openvox.core.digest import map_digest
from openvox.core.mapper_parameters import OPENVOX
from openvox.core.types import Frame, Intrinsics, Mask, Pose, Rig
from openvox.formats.perception import SUFFIX, read_masks
from openvox.formats.recording import read_frames
from openvox.mapper.mapper import Mapper

STAGES = ("masks", "project", "associate", "evolve")
Items = Sequence[tuple[Frame, tuple[Mask, ...]]]


class CpuWatch:
    """CPU milliseconds of every stage and frame."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {}
        self._stage, self._begin = "", 0.0

    def lap(self, stage: str) -> None:
        now = time.thread_time()
        if self._stage:
            self.times.setdefault(self._stage, []).append(1000 * (now - self._begin))
        self._stage, self._begin = stage, now


def timed(items: Items, mapper: Mapper, watch: CpuWatch) -> dict[str, np.ndarray]:
    """Milliseconds of each stage and of whole steps, one a frame."""
    watch.times = {}
    for frame, masks in items:
        mapper.step(frame, masks)
    stages = {name: np.array(watch.times[name]) for name in STAGES}
    return {**stages, "step": np.sum(list(stages.values()), axis=0)}


def shifted(items: Items, metres: float) -> Items:
    out = []
    for frame, masks in items:
        x, y, z = frame.world_from_depth.translation
        pose = Pose(frame.world_from_depth.quaternion, (x + metres, y, z))
        out.append((replace(frame, world_from_depth=pose), masks))
    return out


def engines(items: Items) -> None:
    print(
        "| engine | "
        + " | ".join(f"{name} ms (to cpu)" for name in (*STAGES, "step"))
        + " | map digest |\n"
        + "|---" * 7
        + "|"
    )
    names = ["cpu", "numpy", *(["torch"] if importlib.util.find_spec("torch") else [])]
    first: dict[str, float] = {}
    for name in names:
        warm_up(OPENVOX, "cpu" if name == "numpy" else name, print)
        watch = CpuWatch()
        mapper = with_numpy(Mapper(OPENVOX, watch)) if name == "numpy" else Mapper(OPENVOX, watch, name)
        found = timed(items, mapper, watch)
        medians = {stage: float(np.median(times)) for stage, times in found.items()}
        first = first or medians
        cells = [
            f"{medians[stage]:.2f} / {np.percentile(times, 95):.2f} ({medians[stage] / first[stage]:.1f})"
            for stage, times in found.items()
        ]
        print(f"| {name} | " + " | ".join(cells) + f" | {map_digest(mapper.finish())[:10]} |", flush=True)


def growth(places: Callable[[int], Items], again: Items, sizes: Sequence[int]) -> None:
    """places: what is seen at each place; again: what is timed, at the first one. sizes: how many places."""
    gc.freeze()  # as apps.loop does
    print("\n| voxels | fragments | step ms | to the first | longest step | bytes a voxel |\n" + "|---" * 6 + "|")
    watch = CpuWatch()
    mapper = Mapper(OPENVOX, watch)
    first, number, longest = 0.0, 0, 0.0
    for size in sorted(sizes):
        while number < size:
            longest = max(longest, float(timed(places(number), mapper, watch)["step"].max()))
            number += 1
        found = timed(again, mapper, watch)["step"]
        median, voxels = float(np.median(found)), mapper.voxels
        first = first or median
        print(
            f"| {voxels} | {mapper.fragments} | {median:.2f} / {np.percentile(found, 95):.2f} | {median / first:.2f} "
            f"| {longest:.0f} | {mapper.bytes / voxels:.1f} |",
            flush=True,
        )


def rooms(items: Items, sizes: Sequence[int]) -> None:
    """The recording again and again; behind the first place every fourth frame is enough."""
    growth(lambda n: shifted(items[:: 4 if n else 1], 100.0 * n), items[1::3], sizes)


def walls(sizes: Sequence[int]) -> None:
    """A wall of a hundred things a place, seen by a 1280x720 camera."""
    camera = Intrinsics(1280, 720, 900.0, 900.0, 639.5, 359.5)
    masks = []
    for u, v in itertools.product(range(0, 1280, 128), range(0, 720, 72)):
        bitmap = np.zeros((720, 1280), np.bool_)
        bitmap[v : v + 72, u : u + 128] = True
        masks.append(Mask.from_bitmap(bitmap))
    depth = np.full((720, 1280), 2000, np.uint16)
    frame = Frame(0, 0, Pose.identity(), Rig(camera, camera), depth)
    growth(lambda n: shifted([(frame, tuple(masks))], 10.0 * n), [(frame, tuple(masks))] * 30, sizes)


def end_to_end(recording: Path, out: Path) -> None:
    wall, cpu = time.perf_counter(), time.process_time()
    frames = sum(1 for _ in read_frames(recording, truth=False))
    masks = sum(1 for _ in read_masks(recording.with_suffix(SUFFIX)))
    alone = time.perf_counter() - wall, time.process_time() - cpu
    warm_up(OPENVOX, "cpu", print)
    wall, cpu, own = time.perf_counter(), time.process_time(), time.thread_time()
    replay(recording, out=str(out))
    wall, cpu, own = time.perf_counter() - wall, time.process_time() - cpu, time.thread_time() - own
    print(
        f"\nreplay of {frames} frames ({masks} with masks): {frames / wall:.0f} frames/s, "
        f"{wall / alone[0]:.1f} x decoding alone; "
        f"CPU {1000 * cpu / frames:.1f} ms a frame, {cpu / alone[1]:.1f} x decoding alone, "
        f"{own / cpu:.2f} of it in the mapping thread"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, help="with its perception beside it")
    parser.add_argument("--tiles", type=int, nargs="+", default=[1, 11, 130], help="places of the growing world")
    parser.add_argument("--walls", type=int, nargs="+", default=[3, 30, 300], help="walls of the other growing world")
    parser.add_argument("--out", type=Path, default=Path("/tmp/openvox-bench"), help="stem for the map of the replay")
    arguments = parser.parse_args()
    known = {found.index: found.masks for found in read_masks(arguments.recording.with_suffix(SUFFIX))}
    items = [(frame, known[frame.index]) for frame in read_frames(arguments.recording, truth=False)]
    gc.freeze()
    engines(items)
    end_to_end(arguments.recording, arguments.out)
    rooms(items, arguments.tiles)
    walls(arguments.walls)


if __name__ == "__main__":
    main()
