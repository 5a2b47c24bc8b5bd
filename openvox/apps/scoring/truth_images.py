"""Pictures of true instance ids with the camera that saw them, from a scene's folder or a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.types import DepthImage, IdImage, Intrinsics
from openvox.formats.images import decode_png16
from openvox.formats.recording import read_frames, recording_info
from openvox.sources.source import camera_of, numbered, parse_matrix, pose_of, read_bytes, read_text
from openvox.view.viewpoint import world_from_color


@dataclass(frozen=True, eq=False)
class TruthImage:
    """True instance ids in colour pixels, 0 = background."""

    frame: int
    instances: IdImage
    world_from_camera: NDArray[np.float64]
    """(4, 4), of the colour camera."""
    camera: Intrinsics
    depth: DepthImage | None
    """Millimetres in the same pixels; None where depth has another camera."""


def count_images(truth: Path) -> int:
    """How many pictures `truth_images` gives, frames without a pose included; 0 where the truth has none."""
    if truth.is_dir():
        return len(numbered(truth / "instance-filt", (".png",)))
    info = recording_info(truth)
    return info.frames if info.has_truth else 0


def truth_images(truth: Path) -> Iterator[TruthImage]:
    """The truth's pictures by frame number; a folder needs instance-filt/, pose/ and intrinsic/. Raises InputError."""
    if truth.is_dir():
        yield from _folder_images(truth)
        return
    for frame in read_frames(truth):
        if frame.truth_instances is not None:
            depth = frame.depth if frame.rig.registered else None
            yield TruthImage(frame.index, frame.truth_instances, world_from_color(frame), frame.rig.color, depth)


def _folder_images(folder: Path) -> Iterator[TruthImage]:
    images, poses = numbered(folder / "instance-filt", (".png",)), numbered(folder / "pose", (".txt",))
    depths = numbered(folder / "depth", (".png",)) if (folder / "depth").is_dir() else {}
    for number, path in images.items():
        if number not in poses:
            raise InputError(f"{folder} has no pose of frame {number}, which {path.name} in instance-filt/ needs")
        where = str(poses[number])
        pose = pose_of(parse_matrix(read_text(poses[number]), where), (0, 0, 0), where)
        if pose is None:  # tracking was lost
            continue
        instances = _picture(path, or_8=True)
        color, own = (_camera(folder, kinds, instances) for kinds in (("color", "depth"), ("depth", "color")))
        depth = _picture(depths[number]) if number in depths and own == color else None
        if depth is not None and depth.shape != instances.shape:
            depth = None
        yield TruthImage(number, instances, pose.matrix(), color, depth)


def _picture(path: Path, *, or_8: bool = False) -> NDArray[np.uint16]:
    try:
        return decode_png16(read_bytes(path), or_8=or_8)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _camera(folder: Path, kinds: tuple[str, str], instances: IdImage) -> Intrinsics:
    """Of the first kind that the folder has."""
    first, second = (folder / "intrinsic" / f"intrinsic_{kind}.txt" for kind in kinds)
    path = first if first.exists() else second
    return camera_of(parse_matrix(read_text(path), str(path)), (instances.shape[1], instances.shape[0]), str(path))
