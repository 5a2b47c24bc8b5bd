"""Poses, depth unit and focal length: what would make the frames agree better than they do as they are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from openvox.apps.examining.agreement import Pairs, agreement, find_pairs
from openvox.apps.examining.finding import Code, Finding
from openvox.apps.examining.sample import Floats, Sample, usual_interval
from openvox.sources.corrections import AXES, OURS, ours

GAIN = 1.06
"""Times the agreement as it is, from which another reading counts. Good recordings stay below 1.02."""
SURE = 4.0
"""Standard errors by which the mean gain over the pairs must differ from 0."""
SOUND = 0.25
"""Agreement that the better reading must reach over the shortest gap; good recordings have 0.7 to 0.9."""
LONGEST_SHIFT = 1.6
"""Seconds that are searched."""
PEAK, SPAN, LEAN = 0.014, 0.1, 2.5
"""Seconds off 0 at which the agreement over shifts of +-SPAN peaks, from which on poses are late even where
interpolation between them costs what the shift gains. Good recordings: below 0.008; late by 0.05: above 0.021.
LEAN: standard errors by which it must beat the same shift to the other side."""
SMALLEST_TURN, SMALLEST_SHIFT, SMALLEST_FACTOR = 3.0, 0.010, 1.06
"""Degrees, seconds, and a factor of depth or focal length: less is within what sensors and trackers err."""
FACTORS = (1000.0, 100.0, 10.0, 6.5535, 5.0, 4.0, 3.0, 2.0, 1.5, 1.25, 1.1)
STARTS = 3
"""Readings from which the search for a turn begins, the best ones; and poses as they are."""
KNOWN_AXES = {"RUB": "OpenGL, Blender", "FLU": "a robot's body, ROS", "RUF": "Unity, left-handed", OURS: "OpenCV"}


@dataclass(frozen=True, eq=False)
class Reading:
    """Another way to read the recording, and how well the pairs agree then."""

    code: Code
    scores: Floats
    """(p,): of each pair."""
    base: Floats
    """(p,): as it is, of the same pairs."""
    value: float = 1.0
    """The factor, or seconds."""
    axes: str = OURS
    turn: Rotation | None = None
    """From the depth camera to the camera that the poses are of."""
    mode: str = ""

    @property
    def gain(self) -> float:
        """Times the agreement as it is."""
        return float(self.scores.mean() / max(self.base.mean(), 1e-6))


def examine_motion(sample: Sample) -> tuple[list[Finding], list[str]]:
    """What is wrong with poses, depth unit or focal length, at most one finding; and notes."""
    pairs = find_pairs(sample)
    if len(pairs.a) < 6:
        return [], ["too few frames to see whether poses, depth and intrinsics agree"]
    base = agreement(pairs, sample.pose)
    still = agreement(pairs, np.broadcast_to(np.eye(4), sample.pose.shape))
    best = max(_readings(pairs, base), key=lambda reading: reading.gain)
    near = pairs.gap == pairs.gap.min()
    if _counts(best) and agreement_over(best, near) >= SOUND:
        return [_finding(best)], []
    peak = _peak(pairs)
    if peak is not None:
        return [_finding(peak)], []
    if base.mean() < 1.05 * still.mean() and still.mean() > 0.6:
        return [], ["the camera hardly moves: what its poses mean and the unit of depth cannot be told"]
    if base[near].mean() < SOUND and still[near].mean() > 2 * base[near].mean():
        return [], [f"frames hardly agree ({base[near].mean():.2f} of 1), and no usual cause would mend it"]
    return [], []


def agreement_over(reading: Reading, chosen: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> float:
    """Mean of the chosen pairs; of all where a reading has fewer."""
    return float(reading.scores[chosen].mean() if len(chosen) == len(reading.scores) else reading.scores.mean())


def _counts(reading: Reading) -> bool:
    """Better by more than chance and noise can make it."""
    gained = reading.scores - reading.base
    error = gained.std() / np.sqrt(len(gained))
    return reading.gain >= GAIN and float(gained.mean()) >= SURE * float(error)


def _readings(pairs: Pairs, base: Floats) -> Iterator[Reading]:
    yield Reading("depth_unit", base, base)
    yield from _scales(pairs, base)
    yield from _focals(pairs, base)
    yield from _times(pairs)
    yield from _meanings(pairs, base)


def _scales(pairs: Pairs, base: Floats) -> Iterator[Reading]:
    pose = pairs.sample.pose
    value = _climbed(lambda scale: float(agreement(pairs, pose, scale=scale).mean()))
    if max(value, 1 / value) >= SMALLEST_FACTOR:
        yield Reading("depth_unit", agreement(pairs, pose, scale=value), base, value)


def _focals(pairs: Pairs, base: Floats) -> Iterator[Reading]:
    pose = pairs.sample.pose
    value = _climbed(lambda focal: float(agreement(pairs, pose, focal=focal).mean()), widest=3.0)
    if max(value, 1 / value) >= SMALLEST_FACTOR:
        yield Reading("intrinsics", agreement(pairs, pose, focal=value), base, value)


def _climbed(score: Callable[[float], float], widest: float = 1e3) -> float:
    """The factor of the best score: the best of the usual ones, then in ever smaller steps."""
    usual = sorted(f for factor in FACTORS if factor <= widest for f in (factor, 1 / factor))
    best = max([1.0, *usual], key=score)
    top = score(best)
    for step in (1.08, 1.03, 1.01):
        for trial in (best * step, best / step):
            if (found := score(trial)) > top:
                best, top = trial, found
    return best


def _times(pairs: Pairs) -> Iterator[Reading]:
    """Poses of a little earlier or later; only where one direction gains far more than the other, as noise does not."""
    sample = pairs.sample
    interval = usual_interval(sample.stamp, sample.segments())
    if not np.isfinite(interval):
        return
    shifts = sorted({*(interval * k for k in (0.25, 0.5, 1.0, 2.0)), 0.05, 0.1, *np.arange(0.15, LONGEST_SHIFT, 0.15)})
    found: dict[float, Reading] = {}
    for shift in (s for size in shifts if size <= LONGEST_SHIFT for s in (size, -size)):
        reading = _shifted(pairs, shift)
        if reading is not None:
            found[shift] = reading
    if not found:
        return
    best = max(found.values(), key=lambda reading: reading.gain)
    other = found.get(-best.value)
    if other is not None and other.gain - 1.0 > (best.gain - 1.0) / 2.0:
        return
    for part in (0.125, 0.0625):
        trials = (_shifted(pairs, best.value + sign * part * min(interval, 0.4)) for sign in (1, -1))
        best = max((best, *(trial for trial in trials if trial)), key=lambda reading: reading.gain)
    if abs(best.value) >= SMALLEST_SHIFT:
        yield best


def _peak(pairs: Pairs) -> Reading | None:
    """The reading at the top of a parabola through shifts to both sides and none, if it is off 0 and surely so."""
    earlier, later = _shifted(pairs, -SPAN), _shifted(pairs, SPAN)
    if earlier is None or later is None:
        return None
    bend, lean = (later.gain + earlier.gain) / 2.0 - 1.0, (later.gain - earlier.gain) / 2.0
    top = -lean / (2.0 * bend) * SPAN if bend < -0.02 else 0.0
    if not PEAK <= abs(top) <= SPAN:
        return None
    there, opposite = _shifted(pairs, top), _shifted(pairs, -top)
    if there is None or opposite is None or there.gain < 1.0:
        return None
    gained, lost = (reading.scores - reading.base for reading in (there, opposite))
    error = np.sqrt(gained.var() / len(gained) + lost.var() / len(lost))
    return there if float(gained.mean() - lost.mean()) >= LEAN * float(error) else None


def _shifted(pairs: Pairs, shift: float) -> Reading | None:
    """Every frame with the pose of `shift` seconds later, of the pairs that have one."""
    sample = pairs.sample
    pose, known = shifted_poses(sample, shift)
    usable = known[pairs.a] & known[pairs.b]
    if usable.sum() < max(6, len(usable) // 2):
        return None
    chosen = Pairs(sample, pairs.a[usable], pairs.b[usable], pairs.u, pairs.v)
    return Reading("pose_time", agreement(chosen, pose), agreement(chosen, sample.pose), shift)


def shifted_poses(sample: Sample, shift: float) -> tuple[Floats, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    """(n, 4, 4): the poses of `shift` seconds later, between those that there are; (n,): where that is known."""
    out, known = sample.pose.copy(), np.zeros(len(sample), np.bool_)
    segments = sample.segments()
    for segment in range(int(segments[-1]) + 1):
        here = np.flatnonzero(segments == segment)
        if len(here) < 2:
            continue
        stamps, wanted = sample.stamp[here], sample.stamp[here] + shift
        inside = (wanted >= stamps[0]) & (wanted <= stamps[-1])
        at, wanted = here[inside], wanted[inside]
        if len(at):
            turns = Rotation.from_matrix(sample.pose[here, :3, :3])
            out[at, :3, :3] = Slerp(stamps, turns)(wanted).as_matrix()
            for axis in range(3):
                out[at, axis, 3] = np.interp(wanted, stamps, sample.pose[here, axis, 3])
            known[at] = True
    return out, known


def _meanings(pairs: Pairs, base: Floats) -> Iterator[Reading]:
    """Inverted, of other axes, both, or of a camera that is turned against ours."""
    sample = pairs.sample
    few = Pairs(sample, pairs.a[::3], pairs.b[::3], pairs.u, pairs.v)
    as_is = float(agreement(few, sample.pose).mean())
    found: list[tuple[float, str, str]] = []
    modes = _modes(sample.pose)
    for mode, pose in modes.items():
        for axes in AXES if mode in ("", "inverted") else (OURS,):
            # what has a name is tried first, and another must be clearly better
            score = float(agreement(few, ours(pose, axes)).mean()) * (1.0 if axes in KNOWN_AXES else 0.97)
            found.append((score, mode, axes))
    starts = [
        ("", OURS),
        *(one[1:] for one in sorted(found, key=lambda one: -one[0])[:STARTS] if one[0] > 1.05 * as_is),
    ]
    mode, axes, turn = max(
        ((mode, axes, *_turned(few, ours(modes[mode], axes))) for mode, axes in starts), key=lambda one: one[3]
    )[:3]
    pose = modes[mode]
    if np.degrees(turn.magnitude()) < SMALLEST_TURN:
        turn = Rotation.identity()
    scores = agreement(pairs, _mounted(ours(pose, axes), turn))
    code: Code = "pose_inverted" if mode == "inverted" else "pose_axes"
    yield Reading(code, scores, base, axes=axes, turn=turn, mode=mode)


def _modes(pose: Floats) -> dict[str, Floats]:
    """The usual ways in which a pose is written wrongly, undone."""
    quaternion = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
    readings: dict[str, Floats] = {
        "": pose[:, :3, :3],
        "transposed": np.swapaxes(pose[:, :3, :3], 1, 2),
        "w first": Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix(),
        "w last": Rotation.from_quat(np.roll(quaternion, 1, axis=1)).as_matrix(),
    }
    out: dict[str, Floats] = {"inverted": np.asarray(np.linalg.inv(pose), np.float64)}
    for mode, turns in readings.items():
        out[mode] = pose.copy()
        out[mode][:, :3, :3] = turns
    return out


def _mounted(pose: Floats, turn: Rotation) -> Floats:
    out = pose.copy()
    out[:, :3, :3] = pose[:, :3, :3] @ turn.as_matrix()
    return out


def _turned(pairs: Pairs, pose: Floats) -> tuple[Rotation, float]:
    """The turn of the camera against the poses that makes the frames agree best, by ever smaller steps; how well."""
    best, top = Rotation.identity(), float(agreement(pairs, pose).mean())
    for degrees in (24.0, 12.0, 6.0, 3.0, 1.5, 0.75):
        for _ in range(4):
            begun = top
            for axis in np.vstack([np.eye(3), -np.eye(3)]):
                trial = best * Rotation.from_rotvec(np.radians(degrees) * axis)
                if (score := float(agreement(pairs, _mounted(pose, trial)).mean())) > top:
                    best, top = trial, score
            if top == begun:
                break
    return best, top


def _finding(reading: Reading) -> Finding:
    figure = f"neighbouring frames agree by {reading.base.mean():.2f} as they are, by {reading.scores.mean():.2f} so"
    texts = {
        "depth_unit": _say_scale,
        "intrinsics": _say_focal,
        "pose_time": _say_time,
        "pose_axes": _say_axes,
        "pose_inverted": _say_axes,
    }
    return texts[reading.code](reading, figure)


def _say_scale(reading: Reading, figure: str) -> Finding:
    factor = min((f for size in FACTORS for f in (size, 1 / size)), key=lambda f: abs(np.log(reading.value / f)))
    close = abs(np.log(reading.value / factor)) < 0.04
    value = factor if close else reading.value
    many = f"{1 / value:.4g} times too large" if value < 1 else f"{value:.4g} times too small"
    return Finding(
        "depth_unit",
        f"Depth is about {many} for the way that the camera goes.",
        f"{figure}: depth times {value:.4g}",
        "depth was read in another unit than it is stored in (as 5000 units a metre, TUM, for millimetres), or the "
        "positions of the poses are in another unit than metres",
        f"openvox ingest with --depth-scale {value:.6g}",
    )


def _say_focal(reading: Reading, figure: str) -> Finding:
    return Finding(
        "intrinsics",
        f"The depth camera's focal length is off: {reading.value:.3g} times as much fits.",
        f"{figure}: fx and fy times {reading.value:.3g}",
        "intrinsics of another camera, another resolution or another crop",
        "correct the depth camera's intrinsics in the source (of some sources: openvox ingest with --camera FILE)",
    )


def _say_time(reading: Reading, figure: str) -> Finding:
    late = "late" if reading.value > 0 else "early"
    return Finding(
        "pose_time",
        f"Poses come about {abs(reading.value) * 1000:.0f} ms too {late} for the pictures: each picture fits the pose "
        f"of that much {'later' if reading.value > 0 else 'earlier'}.",
        f"{figure}: poses of {reading.value * 1000:+.0f} ms",
        "the clocks of camera and tracker differ, or stamps are of the arrival, not of the exposure",
        f"openvox ingest with --pose-shift {reading.value:.3f}",
    )


def _say_axes(reading: Reading, figure: str) -> Finding:
    turned = reading.turn is not None and reading.turn.magnitude() > 0
    said, options, cause = [], [], []
    if reading.mode == "inverted":
        said.append("poses are inverted: they take the world to the camera")
        options.append("--poses-inverted")
        cause.append("the source has world-to-camera poses (as COLMAP and most extrinsics)")
    elif reading.mode:
        what = (
            "the rotation is transposed" if reading.mode == "transposed" else f"the quaternion has its {reading.mode}"
        )
        said.append(f"{what} in the source")
        options.append("the rotations corrected in a trajectory of your own: --poses FILE (stamp tx ty tz qx qy qz qw)")
        cause.append("the poses were written in another order")
    if reading.axes != OURS:
        said.append(f"poses are of a camera whose axes point {reading.axes}{_called(reading.axes)}, not {OURS}")
        options.append(f"--pose-axes {reading.axes}")
        cause.append("the poses follow another convention of axes")
    if turned and reading.turn is not None:
        said.append(f"the camera is turned by {np.degrees(reading.turn.magnitude()):.0f} degrees against its poses")
        matrix = np.eye(4)
        matrix[:3, :3] = reading.turn.as_matrix()
        rows = " / ".join(" ".join(f"{value:.4f}" for value in row) for row in matrix)
        options.append(f"--extrinsic FILE with the lines {rows}")
        cause.append("the poses are of another body than the depth camera (a tracker, the robot, the other camera)")
    what = "; ".join(said)
    return Finding(
        reading.code,
        what[:1].upper() + what[1:] + ".",
        figure,
        "; ".join(cause),
        "openvox ingest with " + " ".join(options),
    )


def _called(axes: str) -> str:
    return f" ({KNOWN_AXES[axes]})" if axes in KNOWN_AXES else ""
