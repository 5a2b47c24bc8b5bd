"""What single frames tell: stamps, black pictures, missing depth, depth that no sensor gives, odd intrinsics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from openvox.apps.examining.finding import Finding
from openvox.apps.examining.sample import GAP, Floats, Sample, usual_interval
from openvox.core.types import Intrinsics, Rig

SHORTEST_GAP = 0.3
"""Seconds: a frame or two lost at a camera's rate are nothing to speak of."""
DARK, FLAT = 16.0, 8.0
"""Of 255: the brightest of a black picture, and the contrast of one that shows nothing."""
BLACK_SHARE, MISSING_SHARE, EMPTY_SHARE = 0.1, 0.4, 0.1
"""Pictures that may show nothing; measured pixels that there must be; frames that may be without any."""
CENTER, RATIO = 0.12, 1.2
"""Of the side: how far the principal point may be off the middle. Times that fx may differ from fy."""
FIELD = (20.0, 130.0)
"""Degrees that a picture may be wide."""
FULL, FULL_SHARE = np.iinfo(np.uint16).max, 0.01
"""The largest depth, and pixels that may say it by chance."""
LEAST_M, MOST_M = 0.06, 30.0
"""Metres: the median of depth that RGB-D sensors give indoors and out."""


def examine_frames(sample: Sample) -> list[Finding]:
    """All findings but those that compare frames."""
    return [
        *stamps(sample),
        *dropped_stamps(sample.dropped),
        *black(sample.bright, sample.contrast),
        *missing(sample.valid),
        *(list(unit(sample)) or full(sample.depth)),
        *intrinsics(sample.rig),
    ]


def stamps(sample: Sample) -> Iterator[Finding]:
    """Gaps; and jumps of the clock, over which the camera goes on as if nothing had been."""
    interval = usual_interval(sample.stamp, sample.block)
    if len(sample) < 4 or not np.isfinite(interval):
        return
    waits = np.diff(sample.stamp)
    long = (waits > max(GAP * interval, SHORTEST_GAP)) & (np.diff(sample.block) == 0)
    steps = movement(sample.pose)
    around = np.array([np.median(np.delete(steps[max(0, i - 2) : i + 3], min(i, 2))) for i in range(len(steps))])
    jumped = long & (waits > 1.0) & (steps < 2 * around) & (steps > around / 4)
    for code, where, text, cause, cure in (
        (
            "stamps",
            long & ~jumped,
            "Stamps have {n} gap(s); the longest is {s:.2f} s, after frame {f}.",
            "the recorder lost messages, was paused, or frames were left out",
            "nothing brings them back: go on with the longest whole stretch, openvox ingest with --start N --end N",
        ),
        (
            "clock",
            jumped,
            "The clock jumps {n} time(s); the largest is {s:.2f} s, after frame {f}, and the camera goes on as before.",
            "the clock was set while recording, or two runs were joined",
            "openvox ingest with --start N --end N for a stretch between jumps, or with --invent-stamps --fps N",
        ),
    ):
        if where.any():
            worst = int(np.where(where, waits, 0).argmax())
            said = text.format(n=int(where.sum()), s=waits[worst], f=int(sample.number[worst]))
            figure = f"{waits[worst]:.2f} s where {interval:.3f} s are usual"
            yield Finding(code, said, figure, cause, cure)  # type: ignore[arg-type]


def movement(pose: Floats) -> Floats:
    """(n - 1,): metres and radians together that a camera goes from frame to frame."""
    turns = np.swapaxes(pose[:-1, :3, :3], 1, 2) @ pose[1:, :3, :3]
    cosine = (np.trace(turns, axis1=1, axis2=2) - 1.0) / 2.0
    moved: Floats = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1)
    moved += np.arccos(np.clip(cosine, -1.0, 1.0))
    return moved


def dropped_stamps(dropped: Mapping[str, int]) -> Iterator[Finding]:
    """What a source left out because of its stamp."""
    for reason, count in dropped.items():
        if "stamp" in reason and "--pose-shift" not in reason:
            yield Finding(
                "clock",
                f"{count} frame(s) cannot be used because of their stamps: {reason}.",
                f"{count} frames",
                "the clock was set back while recording, or messages are repeated or out of order",
                "openvox ingest leaves them out; of folders it makes new ones with --invent-stamps --fps N",
            )


def black(bright: Floats, contrast: Floats) -> Iterator[Finding]:
    """Pictures without light, or without anything to see; NaN where no picture was looked at."""
    seen = np.isfinite(bright)
    nothing = seen & ((bright < DARK) | (contrast < FLAT))
    if seen.any() and nothing.sum() > BLACK_SHARE * seen.sum():
        yield Finding(
            "black",
            f"{nothing.sum()} of {seen.sum()} colour pictures that were looked at are black or show one colour only.",
            f"{nothing.sum() / seen.sum():.0%} of the pictures; the brightest 1 % of the median one is at "
            f"{np.median(bright[seen]):.0f} of 255",
            "the lens was covered, the exposure failed, the light was off, or the wrong topic or folder was taken",
            "openvox ingest with --topic color=NAME takes another one (a log), --start N --end N the good part",
        )


def missing(valid: Floats) -> Iterator[Finding]:
    """Depth that is mostly not there."""
    empty = float((valid < 0.02).mean())
    if valid.mean() < MISSING_SHARE or empty > EMPTY_SHARE:
        yield Finding(
            "depth_missing",
            f"Depth is mostly missing: {valid.mean():.0%} of its pixels are measured, and {empty:.0%} of the frames "
            "have none.",
            f"{valid.mean():.3f} of the pixels",
            "too near, too far or too shiny for the sensor; sunlight; or the wrong depth topic or a wrong unit",
            "take the right one: openvox ingest with --topic depth=NAME (a log), --depth-scale F for a unit, or "
            "--start N --end N for the good part",
        )


def full(depth: NDArray[np.uint16]) -> Iterator[Finding]:
    """Depth that says the largest number there is."""
    share = float((depth == FULL).mean()) if depth.size else 0.0
    if share > FULL_SHARE:
        yield Finding(
            "depth_missing",
            f"{share:.0%} of the depth pixels say {FULL}, the largest number that fits.",
            f"{share:.3f} of the pixels",
            "a mark for nothing measured, or distances that do not fit into 16 bits",
            "nothing, if it is a mark: replay ignores what is beyond map.max_depth; else read the source again with "
            "another unit",
        )


def unit(sample: Sample) -> Iterator[Finding]:
    """Depth so small or large that it can only be the unit."""
    measured = sample.depth[:: max(1, len(sample) // 40)]
    measured = measured[measured > 0]
    if not len(measured):
        return
    middle = float(np.median(measured)) / 1000.0
    full = float((measured == FULL).mean())
    if middle < LEAST_M or middle > MOST_M or full > 0.2:
        small = middle < LEAST_M
        yield Finding(
            "depth_unit",
            f"The median depth is {middle:.3g} m, which {'is nearer than a sensor sees' if small else 'no room has'}.",
            f"median {middle:.4g} m, {full:.0%} of it at the largest number that fits",
            "metres were read as millimetres" if small else "millimetres were read as metres, or as another unit",
            f"openvox ingest with --depth-scale {1000 if small else 0.001:g}; better, read the source again with the "
            "right unit, as small numbers are lost in between",
        )


def intrinsics(rig: Rig) -> Iterator[Finding]:
    """Cameras that do not fit the size of their pictures."""
    cameras = {"depth": rig.depth} | ({} if rig.color == rig.depth else {"colour": rig.color})
    for name, camera in cameras.items():
        wrong = list(_odd(camera))
        if wrong:
            yield Finding(
                "intrinsics",
                f"The {name} camera's intrinsics do not fit its pictures of {camera.width}x{camera.height}: "
                f"{', '.join(text for text, _ in wrong)}.",
                ", ".join(figure for _, figure in wrong),
                "intrinsics of another resolution, another crop or another camera, or numbers in another order",
                "correct them in the source (of some sources: openvox ingest with --camera FILE); if the pictures were "
                "made smaller, fx, fy, cx and cy shrink with them",
            )


def _odd(camera: Intrinsics) -> Iterator[tuple[str, str]]:
    sides = (("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height))
    for name, at, size in sides:
        if abs((at + 0.5) / size - 0.5) > CENTER:
            yield f"{name} is far from the middle", f"{name} {at:.1f} of {size}"
    if not 1 / RATIO < camera.fx / camera.fy < RATIO:
        yield "fx and fy are far apart", f"fx {camera.fx:.1f}, fy {camera.fy:.1f}"
    wide = float(np.degrees(2 * np.arctan(camera.width / 2 / camera.fx)))
    if not FIELD[0] < wide < FIELD[1]:
        yield "the picture would be oddly wide or narrow", f"{wide:.0f} degrees wide"
