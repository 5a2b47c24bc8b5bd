"""Tiny worlds for tests: three boxes on a floor, seen by a 32x24 camera that walks past them.

World: metres, z up, floor at z = 0. Everything is exact and the same on every run; depth, ids and colour of a pixel
come from the same ray through its centre.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Frame, Intrinsics, Mask, Pose, Rig

CAMERA = Intrinsics(width=32, height=24, fx=26.0, fy=26.0, cx=15.5, cy=11.5)
CATEGORIES = {2: "floor", 7: "table", 29: "box"}
FLOOR_CATEGORY = 2


@dataclass(frozen=True)
class Box:
    instance: int
    category: int
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    color: tuple[int, int, int]


BOXES = (
    Box(1, 7, (-0.9, 1.6, 0.0), (-0.2, 2.2, 0.5), (200, 60, 50)),
    Box(2, 29, (0.1, 1.4, 0.0), (0.5, 1.8, 0.35), (60, 180, 70)),
    Box(3, 29, (0.3, 2.4, 0.0), (1.1, 3.0, 0.9), (70, 80, 210)),
)


def tiny_frames(
    n: int = 3,
    *,
    camera: Intrinsics = CAMERA,
    color_format: Literal["jpeg", "png", ""] = "jpeg",
    truth: bool = True,
    first: int = 0,
    stride: int = 1,
) -> list[Frame]:
    """n frames, numbered first, first + stride, ...; 10 Hz from 1 s on; registered colour and depth."""
    return [_frame(first + stride * i, camera, color_format, truth) for i in range(n)]


def _frame(index: int, camera: Intrinsics, color_format: Literal["jpeg", "png", ""], truth: bool) -> Frame:
    pose = look_at((0.08 * index - 0.1, -0.4, 1.0), (0.03 * index, 2.0, 0.3))
    depth, instances, categories, color = render(pose, camera)
    return Frame(
        index=index,
        stamp_ns=1_000_000_000 + index * 100_000_000,
        world_from_depth=pose,
        rig=Rig(camera, camera),
        depth=depth,
        color=encode_color(color, color_format),
        color_format=color_format,
        truth_instances=instances if truth else None,
        truth_categories=categories if truth else None,
    )


def truth_masks(frame: Frame) -> tuple[Mask, ...]:
    """The truth of a frame as masks, one an instance, by id."""
    truth = frame.truth_instances
    assert truth is not None
    return tuple(Mask.from_bitmap(truth == i, caption=f"thing {i}") for i in np.unique(truth).tolist() if i)


def look_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> Pose:
    """Camera-to-world pose at `eye`, z axis towards `target`, x axis level."""
    forward = np.subtract(target, eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right = right / np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = eye
    return Pose.from_matrix(matrix)


def render(
    pose: Pose, camera: Intrinsics, boxes: tuple[Box, ...] = BOXES
) -> tuple[NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint16], NDArray[np.uint8]]:
    """Depth (mm), instance ids, category ids, RGB, each (height, width); the sky has depth 0."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u, float)], -1)
    matrix = pose.matrix()
    direction, origin = rays @ matrix[:3, :3].T, matrix[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(direction[..., 2] < 0, -origin[2] / direction[..., 2], np.inf)
        hits = [_enter(origin, direction, box) for box in boxes]
    instances = np.zeros(depth.shape, np.uint16)
    categories = np.where(np.isfinite(depth), FLOOR_CATEGORY, 0).astype(np.uint16)
    color = np.full((*depth.shape, 3), 150, np.uint8)
    for box, hit in zip(boxes, hits, strict=True):
        nearer = hit < depth
        depth = np.where(nearer, hit, depth)
        instances[nearer], categories[nearer], color[nearer] = box.instance, box.category, box.color
    millimetres = np.where(np.isfinite(depth) & (depth < 8.0), np.rint(depth * 1000.0), 0).astype(np.uint16)
    return millimetres, instances, categories, color


def _enter(origin: NDArray[Any], direction: NDArray[Any], box: Box) -> NDArray[Any]:
    """Distance along each ray (in units of camera z) at which it enters the box; infinity where it misses."""
    near, far = (np.array(box.low) - origin) / direction, (np.array(box.high) - origin) / direction
    enter, leave = np.minimum(near, far).max(-1), np.maximum(near, far).min(-1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)


def encode_color(color: NDArray[np.uint8], color_format: Literal["jpeg", "png", ""]) -> bytes:
    """RGB picture to the bytes of a file of that format; no bytes for ''."""
    if not color_format:
        return b""
    done, data = cv2.imencode(".jpg" if color_format == "jpeg" else ".png", color[..., ::-1])
    assert done
    return data.tobytes()


def write_scannet(folder: Path, frames: list[Frame], *, digits: int = 6) -> Path:
    """The frames as an exported ScanNet scene, with names of so many digits (0: unpadded); returns the folder."""
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True)
    for name, camera in (("color", frames[0].rig.color), ("depth", frames[0].rig.depth)):
        np.savetxt(folder / "intrinsic" / f"intrinsic_{name}.txt", intrinsic_matrix(camera))
    for frame in frames:
        stem = f"{frame.index:0{digits}d}"
        (folder / "color" / f"{stem}.{'jpg' if frame.color_format == 'jpeg' else 'png'}").write_bytes(frame.color)
        write_png16(folder / "depth" / f"{stem}.png", frame.depth)
        np.savetxt(folder / "pose" / f"{stem}.txt", frame.world_from_depth.matrix(), fmt="%.17g")
        for name, ids in (("instance-filt", frame.truth_instances), ("label-filt", frame.truth_categories)):
            if ids is not None:
                (folder / name).mkdir(exist_ok=True)
                write_png16(folder / name / f"{stem}.png", ids)
    (folder / "stamps.txt").write_text("".join(f"{decimal_seconds(frame.stamp_ns)}\n" for frame in frames))
    objects = {"categories": {name: number for number, name in CATEGORIES.items()}, "objects": []}
    (folder / "objects.json").write_text(json.dumps(objects))
    return folder


def decimal_seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def intrinsic_matrix(camera: Intrinsics) -> NDArray[np.float64]:
    """(4, 4), as ScanNet writes it."""
    matrix = np.eye(4)
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    return matrix


def write_png16(path: Path, image: NDArray[np.uint16]) -> None:
    assert cv2.imwrite(str(path), image)
