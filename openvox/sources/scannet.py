"""Exported ScanNet scenes: color/ depth/ pose/ intrinsic/, and instance-filt/ label-filt/ if there, and
the names of their categories in objects.json or scannetv2-labels.combined.tsv.

Files are numbered (0.jpg or 000000.jpg); the number is the frame's. Depth is 16-bit PNG in millimetres, poses are 4x4
camera-to-world matrices (-inf where tracking was lost). Colour may be larger than depth and have a camera of its own.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from openvox.core.errors import InputError
from openvox.core.types import Frame, IdImage, Intrinsics, Pose, Rig
from openvox.formats.truth_meshes import LABELS
from openvox.sources.source import (
    NO_POSE,
    TWO_CAMERAS,
    Dropped,
    Options,
    Source,
    camera_of,
    numbered,
    parse_matrix,
    pose_of,
    read_grey,
    read_picture,
    read_stamps,
    read_text,
    scaled,
)

WANTED = ("color/", "depth/", "pose/", "intrinsic/")
_PICTURES = (".jpg", ".jpeg", ".png")
_TRUTH = ("instance-filt", "label-filt")


@dataclass(frozen=True, slots=True)
class _Files:
    """Files of the scene by frame number."""

    color: Mapping[int, Path]
    depth: Mapping[int, Path]
    pose: Mapping[int, Path]
    instances: Mapping[int, Path]
    categories: Mapping[int, Path]


def missing(folder: Path, options: Options) -> list[str]:
    """What a folder lacks to be such a scene."""
    return [name for name in WANTED if not (folder / name).is_dir() and not (name == "pose/" and options.poses)]


def read(folder: Path, options: Options) -> Source:
    """Opens a scene. Raises InputError for what is missing or is not what it should be, also while iterating."""
    files = _files(folder)
    numbers = sorted({*files.color, *files.depth, *files.pose})
    if not numbers:
        raise InputError(f"{folder} has no numbered files in color/, depth/ and pose/ (as color/0.jpg, depth/0.png)")
    chosen = options.chosen(folder, numbers)
    _check_complete(folder, files, chosen, options)
    stamps, stamp_notes = _stamps(folder, numbers, options)
    rig, rig_notes = _rig(folder, files.color[chosen[0]], files.depth[chosen[0]])
    return Source(
        kind="scannet",
        depth_unit="mm",
        categories=_categories(folder),
        notes=(*stamp_notes, *rig_notes),
        total=len(chosen),
        frames=_frames(files, chosen, stamps, rig, options),
    )


def _files(folder: Path) -> _Files:
    return _Files(
        color=numbered(folder / "color", _PICTURES),
        depth=numbered(folder / "depth", (".png",)),
        pose=numbered(folder / "pose", (".txt",)),
        instances=numbered(folder / "instance-filt", (".png",)),
        categories=numbered(folder / "label-filt", (".png",)),
    )


def _check_complete(folder: Path, files: _Files, chosen: list[int], options: Options) -> None:
    """Every chosen frame has each of its files."""
    wanted = [("color", files.color), ("depth", files.depth)]
    wanted += [] if options.poses else [("pose", files.pose)]
    wanted += [(name, found) for name, found in zip(_TRUTH, (files.instances, files.categories), strict=True) if found]
    for name, found in wanted:
        for number in chosen:
            if number not in found:
                raise InputError(
                    f"{folder} has no file of frame {number} in {name}/; expected one in each of "
                    f"{', '.join(name + '/' for name, _ in wanted)}"
                )


def _stamps(folder: Path, numbers: list[int], options: Options) -> tuple[dict[int, int], tuple[str, ...]]:
    """Nanoseconds by frame number, and what to say about them."""
    path = folder / "stamps.txt"
    if path.exists() and not options.invent_stamps:
        return dict(zip(numbers, read_stamps(path, len(numbers)), strict=True)), ()
    why = "that was asked for" if path.exists() else "there is no stamps.txt"
    note = f"stamps were invented at {options.fps:g} frames a second: {why}"
    return {number: options.stamp(number) for number in numbers}, (note,)


def _rig(folder: Path, color: Path, depth: Path) -> tuple[Rig, tuple[str, ...]]:
    """Both cameras, from the intrinsics given and the first pictures' sizes, and what to say about them."""
    color_size, depth_size = read_picture(color)[2], read_picture(depth)[2]
    color_camera = _camera(folder / "intrinsic" / "intrinsic_color.txt", color_size)
    depth_camera = _camera(folder / "intrinsic" / "intrinsic_depth.txt", depth_size)
    notes: list[str] = []
    if color_camera is None or depth_camera is None:
        given = color_camera or depth_camera
        if given is None:
            raise InputError(f"{folder / 'intrinsic'} has neither intrinsic_color.txt nor intrinsic_depth.txt")
        color_camera, depth_camera = scaled(given, color_size), scaled(given, depth_size)
        notes.append(
            f"one camera's intrinsics are given, for {given.width}x{given.height} pixels; they were scaled to "
            f"{color_size[0]}x{color_size[1]} for colour and {depth_size[0]}x{depth_size[1]} for depth"
        )
    rig = Rig(depth_camera, color_camera, _depth_from_color(folder / "intrinsic"))
    if not rig.registered:
        notes.append(TWO_CAMERAS)
    return rig, tuple(notes)


def _camera(path: Path, size: tuple[int, int]) -> Intrinsics | None:
    return camera_of(parse_matrix(read_text(path), str(path)), size, str(path)) if path.exists() else None


def _depth_from_color(folder: Path) -> Pose:
    """Identity unless extrinsic_color.txt and extrinsic_depth.txt (both camera-to-rig) say otherwise."""
    poses = []
    for name in ("extrinsic_color.txt", "extrinsic_depth.txt"):
        path = folder / name
        pose = pose_of(parse_matrix(read_text(path), str(path)), (0, 0, 0), str(path)) if path.exists() else None
        poses.append(pose or Pose.identity())
    color, depth = poses
    if depth != Pose.identity():
        raise InputError(f"{folder / 'extrinsic_depth.txt'} is no identity; expected poses of the depth camera itself")
    return color


def _categories(folder: Path) -> dict[int, str]:
    """Number to name, of objects.json's name to number, or of ScanNet's table of labels; empty without either."""
    path = folder / "objects.json"
    if path.exists():
        try:
            named = json.loads(read_text(path)).get("categories", {})
            return {int(number): str(name) for name, number in sorted(named.items())}
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise InputError(
                f"{path}: its categories cannot be read ({error}); expected an object of names and numbers"
            ) from error
    table = next((base / LABELS for base in (folder, folder.resolve().parent) if (base / LABELS).is_file()), None)
    if table is None or not (folder / "label-filt").is_dir():
        return {}
    try:
        rows = csv.DictReader(read_text(table).splitlines(), delimiter="\t")
        return dict(sorted((int(row["id"]), row["category"] or row["raw_category"]) for row in rows))
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(f"{table} cannot be read ({error!r:.200}); expected id, category, raw_category") from error


def _frames(
    files: _Files, chosen: list[int], stamps: Mapping[int, int], rig: Rig, options: Options
) -> Iterator[Frame | Dropped]:
    for number in chosen:
        pose = Pose.identity() if options.poses else _pose(files.pose[number], options)
        if pose is None:
            yield Dropped(number, NO_POSE)
            continue
        color, color_format, _ = read_picture(files.color[number], (rig.color.width, rig.color.height))
        yield Frame(
            index=number,
            stamp_ns=stamps[number],
            world_from_depth=pose,
            rig=rig,
            depth=read_grey(files.depth[number], (rig.depth.width, rig.depth.height)),
            color=color,
            color_format=color_format,
            truth_instances=_ids(files.instances.get(number), rig.color),
            truth_categories=_ids(files.categories.get(number), rig.color),
        )


def _pose(path: Path, options: Options) -> Pose | None:
    return pose_of(parse_matrix(read_text(path), str(path)), options.origin, str(path))


def _ids(path: Path | None, camera: Intrinsics) -> IdImage | None:
    return None if path is None else read_grey(path, (camera.width, camera.height), or_8=True)
