"""Poses from elsewhere, and where the colour camera sits: `--poses`, `--extrinsic`, `--color-from-depth`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from openvox.core.errors import InputError
from openvox.core.types import Frame, Pose, Rig
from openvox.formats.recording import MAX_STAMP_NS
from openvox.sources.corrections import meant
from openvox.sources.source import (
    TWO_CAMERAS,
    Dropped,
    Options,
    Source,
    nanoseconds,
    pose_of,
    read_text,
    read_transform,
)
from openvox.sources.transforms import Track, inverse, placed

Lookup = Callable[[Frame], Pose | str]
TUM, KITTI = 8, 12
"""Numbers of a line: stamp, translation, quaternion; or the upper three rows of the matrix of a frame."""


def with_own_poses(source: Source, options: Options) -> Source:
    """The source with what the options bring instead. Raises InputError, also while iterating."""
    notes = list(source.notes)
    lookup: Lookup | None = None
    depth_from_color: Pose | None = None
    if options.poses is not None:
        told, kind = read_trajectory(options.poses, round(options.max_gap * 1e9))
        lookup = _meant(told, options)
        notes.append(f"poses are those of {options.poses.name} ({kind}), not the source's own")
    if options.color_from_depth is not None:
        depth_from_color = inverse(read_transform(options.color_from_depth))
        notes.append(f"where colour sits beside depth was taken from {options.color_from_depth.name}")
        if depth_from_color != Pose.identity() and TWO_CAMERAS not in notes:
            notes.append(TWO_CAMERAS)
    mount = Pose.identity() if options.extrinsic is None else read_transform(options.extrinsic)
    frames = _frames(source.frames, lookup, mount, depth_from_color, options.origin)
    return replace(source, notes=tuple(notes), frames=frames)


def _frames(
    frames: Iterator[Frame | Dropped],
    lookup: Lookup | None,
    mount: Pose,
    depth_from_color: Pose | None,
    origin: tuple[int, int, int],
) -> Iterator[Frame | Dropped]:
    rig: Rig | None = None
    for frame in frames:
        if isinstance(frame, Dropped):
            yield frame
            continue
        if depth_from_color is not None:
            changed = replace(frame.rig, depth_from_color=depth_from_color)
            rig = rig if rig == changed else changed
            frame = replace(frame, rig=rig)
        found = lookup(frame) if lookup else frame.world_from_depth
        if isinstance(found, str):
            yield Dropped(frame.index, found)
        else:
            yield replace(frame, world_from_depth=placed(found, mount, origin)) if lookup else frame


def _meant(lookup: Lookup, options: Options) -> Lookup:
    def found(frame: Frame) -> Pose | str:
        pose = lookup(frame)
        return pose if isinstance(pose, str) else meant(pose, options)

    return found


def read_trajectory(path: Path, max_gap_ns: int) -> tuple[Lookup, str]:
    """What finds a frame's pose, or says why there is none; and the kind of file, for people. Raises InputError.

    TUM: by stamp, between two lines that are not farther apart than that. KITTI: line N is frame number N."""
    rows, width = _rows(path)
    if width == TUM:
        track = tum_track(path)
        return lambda frame: _said(track.at(frame.stamp_ns, max_gap_ns)), "by stamp"
    if width == KITTI:
        poses = [_matrix(words, f"{path}, line {number}") for number, words in rows]
        return lambda frame: poses[frame.index] if frame.index < len(poses) else "the trajectory ends before", "by line"
    raise InputError(
        f"{path} has lines of {width or 'unequally many'} numbers; expected 8 (TUM: stamp tx ty tz qx qy qz qw) or 12 "
        "(KITTI: the upper three rows of a camera-to-world matrix)"
    )


def tum_track(path: Path) -> Track:
    """A trajectory by stamp: lines of stamp tx ty tz qx qy qz qw. Raises InputError."""
    rows, width = _rows(path)
    if width != TUM:
        raise InputError(f"{path}: expected lines of stamp tx ty tz qx qy qz qw")
    track = Track(window_ns=None)
    for number, words in rows:
        track.add(*_stamped(words, f"{path}, line {number}"))
    return track


def _rows(path: Path) -> tuple[list[tuple[int, list[str]]], int]:
    """Number and words of every line that is no comment, and how many words each has; 0 if not all as many."""
    rows = [
        (number, words)
        for number, line in enumerate(read_text(path).splitlines(), 1)
        if (words := line.partition("#")[0].replace(",", " ").split())
    ]
    widths = {len(words) for _, words in rows}
    return rows, widths.pop() if len(widths) == 1 else 0


def _said(found: Pose | str) -> Pose | str:
    return f"the trajectory {found}" if isinstance(found, str) else found


def _stamped(words: list[str], where: str) -> tuple[int, Pose]:
    try:
        seconds = Decimal(words[0])
        tx, ty, tz, qx, qy, qz, qw = (float(word) for word in words[1:])
    except (InvalidOperation, ValueError) as error:
        raise InputError(f"{where}: {' '.join(words)!r:.80} holds something that is no number") from error
    if not (seconds.is_finite() and 0 <= seconds < MAX_STAMP_NS // 10**9):
        raise InputError(f"{where}: stamp {words[0]!r}; expected seconds between 0 and 2**31")
    try:
        return nanoseconds(seconds), Pose((qx, qy, qz, qw), (tx, ty, tz))
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _matrix(words: list[str], where: str) -> Pose:
    try:
        matrix = np.array([*(float(word) for word in words), 0.0, 0.0, 0.0, 1.0]).reshape(4, 4)
    except ValueError as error:
        raise InputError(f"{where}: {error}; expected 12 numbers") from error
    pose = pose_of(matrix, (0, 0, 0), where)
    if pose is None:
        raise InputError(f"{where} holds a number that is not finite")
    return pose
