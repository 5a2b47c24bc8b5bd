"""Open3D's reconstruction system, and Redwood: color/ (or rgb/, image/), depth/ in millimetres, an intrinsic JSON, and
a trajectory `.log`. The Nth file of each folder is frame N."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from openvox.core.errors import InputError
from openvox.core.types import Intrinsics, Pose, Rig
from openvox.sources import shots
from openvox.sources.source import NO_POSE, Options, Source, listed, parse_matrix, pose_of, read_text, scaled

WANTED = ("color/", "depth/", "camera_intrinsic.json", "trajectory.log")
LONGEST_NUMBER = 10
"""Digits of a frame's number."""
_COLORS = ("color", "rgb", "image")
_LOGS = ("trajectory.log", "scene/trajectory.log", "*.log", "scene/*.log")


def missing(folder: Path, options: Options) -> list[str]:
    """What a folder lacks to be such a data set."""
    found = (
        _color_folder(folder) is not None,
        (folder / "depth").is_dir(),
        options.camera is not None or _intrinsic(folder) is not None,
        options.poses is not None or _log(folder) is not None,
    )
    return [name for name, there in zip(WANTED, found, strict=True) if not there]


def read(folder: Path, options: Options) -> Source:
    """Opens a data set. Raises InputError, also while iterating."""
    color_folder, intrinsic = _color_folder(folder), _intrinsic(folder)
    assert color_folder is not None, "checked by missing()"
    color = _pictures(color_folder, (".jpg", ".jpeg", ".png"))
    depth = _pictures(folder / "depth", (".png",))
    if len(color) != len(depth) or not color:
        raise InputError(
            f"{folder} has {len(color)} pictures of colour and {len(depth)} of depth; expected as many of each, and one"
        )
    chosen = options.chosen(folder, range(len(color)))
    sizes = shots.size_of(color[chosen[0]]), shots.size_of(depth[chosen[0]])
    path = Path(options.camera) if options.camera else intrinsic
    assert path is not None, "checked by missing()"
    camera = shots.open3d_camera(path)
    log = None if options.poses else _log(folder)
    poses = {} if log is None else read_log(log, options.origin)
    notes = [f"stamps were invented at {options.fps:g} frames a second: the format has none"]
    cameras: list[Intrinsics] = []
    for name, size in zip(("colour", "depth"), sizes, strict=True):
        if size != (camera.width, camera.height):
            notes.append(f"intrinsics of {camera.width}x{camera.height} pixels were scaled to {name}'s {size}")
        cameras.append(scaled(camera, size))
    found = shots.frames(_shots(chosen, color, depth, poses, log, options), Rig(cameras[1], cameras[0]))
    return Source("open3d", "mm", {}, tuple(notes), len(chosen), found)


def _shots(
    chosen: list[int],
    color: list[Path],
    depth: list[Path],
    poses: dict[int, Pose | None],
    log: Path | None,
    options: Options,
) -> Iterator[shots.Shot]:
    for number in chosen:
        pose: Pose | str = Pose.identity()
        if log is not None:
            pose = (poses[number] or NO_POSE) if number in poses else "the trajectory lacks the frame"
        yield shots.Shot(number, options.stamp(number), color[number], depth[number], pose)


def read_log(path: Path, origin: tuple[int, int, int]) -> dict[int, Pose | None]:
    """Frame number to camera-to-world pose: a line of three numbers, the first of them the frame's, then a matrix."""
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    poses: dict[int, Pose | None] = {}
    for at in range(0, len(lines), 5):
        where = f"{path}, frame {at // 5}"
        words = lines[at].split()
        if len(words) != 3 or not words[0].isdecimal() or len(words[0]) > LONGEST_NUMBER:
            raise InputError(f"{where}: {lines[at]!r:.80}; expected a line of three whole numbers, then four of four")
        poses[int(words[0])] = pose_of(parse_matrix(" ".join(lines[at + 1 : at + 5]), where), origin, where)
    return poses


def _color_folder(folder: Path) -> Path | None:
    return next((folder / name for name in _COLORS if (folder / name).is_dir()), None)


def _intrinsic(folder: Path) -> Path | None:
    return next(iter(sorted(folder.glob("*intrinsic*.json"))), None)


def _log(folder: Path) -> Path | None:
    return next((path for pattern in _LOGS for path in sorted(folder.glob(pattern))), None)


def _pictures(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    return [path for path in listed(folder) if path.suffix.lower() in suffixes]
