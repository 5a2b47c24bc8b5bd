"""TUM RGB-D: rgb.txt, depth.txt and groundtruth.txt name pictures and poses by stamp; 5000 units of depth are a metre.

A frame is a line of depth.txt. Intrinsics are not in the folder: known for the three cameras of the data set, else
--camera FILE.
"""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path

from openvox.core.errors import InputError
from openvox.core.types import Intrinsics, Pose, Rig
from openvox.formats.recording import MAX_STAMP_NS
from openvox.sources import shots
from openvox.sources.poses import tum_track
from openvox.sources.source import Options, Source, camera_file, nanoseconds, read_text
from openvox.sources.transforms import Track, placed

WANTED = ("rgb.txt", "depth.txt", "groundtruth.txt")
UNITS = 5000
CAMERAS = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3),
    "freiburg2": (520.9, 521.0, 325.1, 249.7),
    "freiburg3": (535.4, 539.2, 320.1, 247.6),
}
"""fx, fy, cx, cy as the data set's authors give them."""


def missing(folder: Path, options: Options) -> list[str]:
    """What a folder lacks to be such a sequence."""
    return [name for name in WANTED if not (folder / name).is_file() and not (name == WANTED[2] and options.poses)]


def read(folder: Path, options: Options) -> Source:
    """Opens a sequence. Raises InputError, also while iterating."""
    colors, depths = (_listed(folder, name) for name in WANTED[:2])
    track = None if options.poses else tum_track(folder / WANTED[2])
    chosen = options.chosen(folder, range(len(depths)))
    sizes = shots.size_of(colors[0][1]), shots.size_of(depths[chosen[0]][1])
    camera, note = _camera(folder, sizes[0], options)
    if sizes[0] != sizes[1]:
        raise InputError(f"{folder}: colour is {sizes[0]} pixels and depth {sizes[1]}; expected depth in colour pixels")
    notes = (
        note,
        "depth in units of 1/5000 m was rounded to millimetres, half to even",
        f"colour was paired with depth by stamp, within {options.tolerance * 1000:g} ms",
    )
    found = shots.frames(_shots(colors, depths, chosen, track, options), Rig(camera, camera), UNITS)
    return Source("tum", "1/5000 m", {}, notes, len(chosen), found)


def _shots(
    colors: list[tuple[int, Path]],
    depths: list[tuple[int, Path]],
    chosen: list[int],
    track: Track | None,
    options: Options,
) -> Iterator[shots.Shot]:
    stamps = [stamp for stamp, _ in colors]
    for number in chosen:
        stamp, depth = depths[number]
        near = shots.nearest(stamps, stamp, options.tolerance * 1e9)
        pose: Pose | str = Pose.identity() if track is None else track.at(stamp, round(options.max_gap * 1e9))
        if isinstance(pose, str):
            pose = f"the trajectory {pose}"
        elif track is not None:
            pose = placed(pose, Pose.identity(), options.origin)
        if near is None:
            pose = f"no colour within {options.tolerance * 1000:g} ms"
        yield shots.Shot(number, stamp, colors[near or 0][1], depth, pose)


def _listed(folder: Path, name: str) -> list[tuple[int, Path]]:
    """Stamps in nanoseconds and files of a list, by stamp; none may lie outside of the folder."""
    found: list[tuple[int, Path]] = []
    for number, line in enumerate(read_text(folder / name).splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        where = f"{folder / name}, line {number}"
        try:
            seconds = Decimal(words[0])
        except InvalidOperation:
            seconds = Decimal("nan")
        if len(words) != 2 or not seconds.is_finite() or not 0 <= seconds < MAX_STAMP_NS // 10**9:
            raise InputError(f"{where}: {line!r:.80}; expected a stamp in seconds and a file")
        path = folder / words[1]
        if not path.resolve().is_relative_to(folder.resolve()):
            raise InputError(f"{where}: {words[1]} lies outside of the folder")
        found.append((nanoseconds(seconds), path))
    if not found:
        raise InputError(f"{folder / name} names no file")
    return sorted(found)


def _camera(folder: Path, size: tuple[int, int], options: Options) -> tuple[Intrinsics, str]:
    if options.camera is not None:
        return camera_file(Path(options.camera), size), f"intrinsics are those of {Path(options.camera).name}"
    known = next((name for name in CAMERAS if name in folder.resolve().name), None)
    if known is None or size != (640, 480):
        raise InputError(
            f"{folder} does not say its intrinsics, and its name not which camera of the data set it is "
            f"({', '.join(CAMERAS)}); give --camera FILE with fx fy cx cy"
        )
    return Intrinsics(
        *size, *CAMERAS[known]
    ), f"intrinsics are those of {known}, its lens taken to be without distortion"
