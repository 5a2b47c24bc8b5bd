"""Masks and captions of a perception file: the faults that a map would inherit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from openvox.apps.examining.finding import Finding
from openvox.core.types import Bitmap, DepthImage, Mask, Rig
from openvox.formats.perception import FrameMasks

EMPTY_SHARE = 0.2
"""Frames without masks, from which on it is said. The detectors of the good recordings leave none."""
MOST, MOST_SHARE = 0.7, 0.05
"""Of the picture that one mask covers, and frames with such a mask. The largest good masks cover 0.52."""
APART, OVER, OVER_SHARE = 0.25, 0.3, 0.2
"""Depth that far from a mask's median (of it), in that share of its pixels, in that share of the masks. Good: 0.05."""
SAME, LARGE = 0.5, 0.02
"""IoU of a thing in two frames, and the share of the picture from which on a mask is large enough to be followed."""
REWORDED, CHANGED_SHARE, FOREIGN_SHARE = 0.6, 0.75, 0.35
"""Cosine below which a caption means something else; captions that differ, or mean something else. Good: 0.34, 0.13."""
FULL, FULL_SHARE = 0.98, 0.5
"""Of its box that a mask fills, and masks that do so: hardly any thing is a rectangle in the picture. Good: 0.002."""
FEWEST = 10
"""Masks from which on a share says something."""


@dataclass
class Counts:
    """What was counted in the frames so far."""

    frames: int = 0
    empty: list[int] = field(default_factory=list)
    covering: list[int] = field(default_factory=list)
    over: list[tuple[float, int, int]] = field(default_factory=list)
    """Share of a mask's pixels that are far from its depth; frame and mask. Only where depth is known."""
    masks: int = 0
    full: list[tuple[int, int]] = field(default_factory=list)
    """Frame and mask, where a mask fills its box."""
    same: int = 0
    changed: int = 0
    foreign: int = 0


Depth = tuple[DepthImage, Rig]


def count(frames: Iterable[FrameMasks], depth_of: Callable[[int], Depth | None]) -> Counts:
    """Goes through the frames. depth_of: of a frame number, where it is to be looked at."""
    counts, last = Counts(), dict[int, Bitmap]()
    before: FrameMasks | None = None
    for found in frames:
        counts.frames += 1
        counts.masks += len(found.masks)
        counts.full += [(found.index, m) for m, mask in enumerate(found.masks) if _is_box(mask)]
        small = {m: _small(mask, found.size) for m, mask in enumerate(found.masks)}
        if not found.masks:
            counts.empty.append(found.index)
        if any(bitmap.mean() > MOST for bitmap in small.values()):
            counts.covering.append(found.index)
        depth = depth_of(found.index)
        if depth is not None:
            counts.over += _over(found, small, depth)
        if before is not None:
            _compare(counts, before.masks, last, found.masks, small)
        before, last = found, small
    return counts


def _small(mask: Mask, size: tuple[int, int]) -> Bitmap:
    """Every few pixels of the mask."""
    step = max(1, size[1] // 160)
    return mask.bitmap(*size)[::step, ::step]


def _is_box(mask: Mask) -> bool:
    x0, y0, x1, y1 = mask.box
    return 0 < FULL * (x1 - x0) * (y1 - y0) <= mask.area


def _over(found: FrameMasks, small: Mapping[int, Bitmap], depth: Depth) -> Iterator[tuple[float, int, int]]:
    """Where both cameras are one, or nearly: depth pixels are looked up by their share of the picture."""
    for m, bitmap in small.items():
        rows, columns = np.nonzero(bitmap)
        h, w = bitmap.shape
        dh, dw = depth[0].shape
        z: NDArray[np.float64] = depth[0][rows * dh // h, columns * dw // w] / 1000.0
        z = z[z > 0]
        if len(z) >= 30:
            middle = np.median(z)
            yield float((np.abs(z - middle) > APART * middle).mean()), found.index, m


def _compare(
    counts: Counts,
    before: tuple[Mask, ...],
    old: Mapping[int, Bitmap],
    now: tuple[Mask, ...],
    new: Mapping[int, Bitmap],
) -> None:
    """Counts how often what is clearly the same thing has another caption than in the frame before."""
    for m, bitmap in new.items():
        if bitmap.mean() < LARGE:
            continue
        overlaps = {o: (bitmap & there).sum() / max((bitmap | there).sum(), 1) for o, there in old.items()
                    if there.shape == bitmap.shape}  # fmt: skip
        best = max(overlaps, key=lambda o: (overlaps[o], -o), default=None)
        if best is None or overlaps[best] < SAME:
            continue
        a, b = before[best], now[m]
        counts.same += 1
        counts.changed += a.caption != b.caption
        if a.embedding is not None and b.embedding is not None:
            counts.foreign += float(a.embedding @ b.embedding) < REWORDED


def examine_masks(counts: Counts) -> Iterator[Finding]:
    """The findings, code `masks`."""
    n = max(counts.frames, 1)
    if len(counts.empty) > EMPTY_SHARE * n:
        yield Finding(
            "masks",
            f"{len(counts.empty)} of {n} frames have no mask, the first is frame {counts.empty[0]}.",
            f"{len(counts.empty) / n:.0%} of the frames",
            "the detector's threshold is too high, its words do not fit the scene, or pictures are black or blurred",
            "lower the detector's threshold (openvox perceive with --set offline.box_score=0.2; with --models "
            "det.score; in a file of --detections its own), or look at the pictures: openvox doctor on the recording",
        )
    if len(counts.covering) > MOST_SHARE * n:
        yield Finding(
            "masks",
            f"{len(counts.covering)} of {n} frames have a mask that covers most of the picture, the first is frame "
            f"{counts.covering[0]}.",
            f"more than {MOST:.0%} of the picture in {len(counts.covering) / n:.0%} of the frames",
            "walls, floor or the whole view were detected as a thing",
            "leave such detections out before openvox perceive with --detections, or let the front end skip background",
        )
    over = [one for one in counts.over if one[0] > OVER]
    if len(counts.over) >= FEWEST and len(over) > OVER_SHARE * len(counts.over):
        worst = max(over)
        yield Finding(
            "masks",
            f"{len(over)} of {len(counts.over)} masks lie over edges of depth; the worst is mask {worst[2]} of "
            f"frame {worst[1]}.",
            f"{len(over) / len(counts.over):.0%} of the masks have more than {OVER:.0%} of their pixels more than "
            f"{APART:.0%} nearer or farther than their middle",
            "masks spill over onto what is behind, boxes stand in for masks, or colour does not lie on depth",
            "use a front end that cuts masks out (openvox perceive with --frontend offline); see openvox doctor on the "
            "recording for registration",
        )
    if counts.masks >= FEWEST and len(counts.full) > FULL_SHARE * counts.masks:
        yield Finding(
            "masks",
            f"{len(counts.full)} of {counts.masks} masks fill their boxes; the first is mask {counts.full[0][1]} of "
            f"frame {counts.full[0][0]}.",
            f"{len(counts.full) / counts.masks:.0%} of the masks fill at least {FULL:.0%} of their box",
            "boxes stand in for masks, so that a map takes what is behind for the thing",
            "add a segmenter ([segcap] of docs/models.md), or leave it out, so that regions from depth take your boxes",
        )
    if counts.same >= FEWEST and (
        counts.changed > CHANGED_SHARE * counts.same or counts.foreign > FOREIGN_SHARE * counts.same
    ):
        yield Finding(
            "masks",
            f"Captions change from frame to frame: {counts.changed} of {counts.same} times the same thing is called "
            f"something else a frame later, {counts.foreign} times with another meaning.",
            f"{counts.changed / counts.same:.0%} differ, {counts.foreign / counts.same:.0%} mean something else",
            "the caption model guesses, or captions hold numbers or places that change",
            "caption with a steadier model, or hand over labels as captions (openvox perceive with --detections)",
        )
