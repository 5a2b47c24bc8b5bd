"""Tiny worlds for hypothesis: a few frames of 12x10 pixels, a few masks, ties on purpose, any parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from openvox.core.mapper_parameters import OFFICIAL, OPENVOX, PAPER, MapperParameters
from openvox.core.parameters import describe, updated
from openvox.core.types import MASK_KINDS, Frame, Intrinsics, Mask, Pose, Rig

WIDTH, HEIGHT = 12, 10
CAMERA = Intrinsics(WIDTH, HEIGHT, 10.0, 10.0, 5.5, 4.5)
COLOR_CAMERA = Intrinsics(14, 11, 11.0, 10.5, 6.5, 5.25)
SWITCHES = tuple(row.name for row in describe(OPENVOX) if isinstance(row.default, bool))
Masks = tuple[Mask, ...] | None


@dataclass(frozen=True, eq=False)
class World:
    """Frames with their masks (None: not looked at), and parameters that suit their size."""

    frames: tuple[tuple[Frame, Masks], ...]
    parameters: MapperParameters


def rectangle(u0: int, v0: int, u1: int, v1: int, camera: Intrinsics = CAMERA, **fields: Any) -> Mask:
    """A mask of columns u0 .. u1 - 1 and rows v0 .. v1 - 1."""
    bitmap = np.zeros((camera.height, camera.width), np.bool_)
    bitmap[v0:v1, u0:u1] = True
    return Mask.from_bitmap(bitmap, **fields)


def wall(index: int, depth: NDArray[np.uint16] | int = 1000, pose: Pose | None = None, rig: Rig | None = None) -> Frame:
    """A frame that sees a flat wall, or the depth image given; from the origin along z if no pose is given."""
    rig = rig or Rig(CAMERA, CAMERA)
    if isinstance(depth, int):
        depth = np.full((rig.depth.height, rig.depth.width), depth, np.uint16)
    return Frame(index, 10**8 * (index + 1), pose or Pose.identity(), rig, depth)


def small(parameters: MapperParameters, **masks: Any) -> MapperParameters:
    """The parameters with limits that fit 12x10 pixels: no least mask, objects of a voxel."""
    return replace(
        parameters,
        map=replace(parameters.map, voxel_size=0.1),
        masks=replace(parameters.masks, **{"min_pixels": 0, **masks}),
        finish=replace(parameters.finish, min_voxels=min(parameters.finish.min_voxels, 1)),
    )


ALTERNATIVES = (("chair", "a chair", 0.25), ("", "a red thing", 0.5), ("box", "a box", 1.0))
"""What a mask may be besides: label, caption, score."""


def rectangles(camera: Intrinsics) -> st.SearchStrategy[tuple[int, int, int, int]]:
    """Corners (u0, v0, u1, v1); sides of few lengths, so that areas are often equal, and sometimes nothing at all."""
    side = st.sampled_from([5, 5, 8, 8, 12, 3, 3, 1, 0])
    start = st.tuples(st.sampled_from([0, 1, 2, 4, 6, 11]), st.sampled_from([0, 1, 2, 4, 5, 9]))
    return st.builds(
        lambda a, w, h: (a[0], a[1], min(camera.width, a[0] + w), min(camera.height, a[1] + h)), start, side, side
    )


@st.composite
def masks(draw: st.DrawFn, camera: Intrinsics, dimensions: int) -> Mask:
    """A mask of one or two rectangles."""
    bitmap = np.zeros((camera.height, camera.width), np.bool_)
    for u0, v0, u1, v1 in draw(st.lists(rectangles(camera), min_size=1, max_size=2)):
        bitmap[v0:v1, u0:u1] = True
    embedding = None
    if dimensions:
        # Directions from a small set: equal ones, unlike ones and opposite ones.
        vector = np.array(
            draw(st.lists(st.sampled_from([-1.0, 0.0, 0.5, 1.0]), min_size=dimensions, max_size=dimensions))
        )
        embedding = (vector / max(1e-9, math.sqrt(float(vector @ vector)))).astype(np.float32)
    return Mask.from_bitmap(
        bitmap,
        score=draw(st.sampled_from([0.3, 0.9, 1.0])),
        caption=draw(st.sampled_from(["", "a chair", "a red box", "a red and green chair", "a green box"])),
        caption_score=draw(st.sampled_from([0.0, 0.5, 1.0])),
        named=draw(st.booleans()),
        alternatives=tuple(draw(st.lists(st.sampled_from(ALTERNATIVES), max_size=2))),
        kind=draw(st.sampled_from(MASK_KINDS)),
        embedding=embedding,
    )


@st.composite
def halves(draw: st.DrawFn, camera: Intrinsics, dimensions: int) -> tuple[Mask, Mask, Mask]:
    """A mask and its left and right part: what a map may weld, cut and join."""
    u0, v0, margin = draw(st.integers(0, 2)), draw(st.integers(0, 2)), draw(st.integers(0, 2))
    whole = rectangle(u0, v0, camera.width - margin, camera.height - margin, camera)
    whole = replace(whole, embedding=draw(masks(camera, dimensions)).embedding, kind=draw(st.sampled_from(MASK_KINDS)))
    captions = draw(st.sampled_from([("", ""), ("a red box", "a green box"), ("a red box", "a red and green chair")]))
    bitmap, column = whole.bitmap(camera.height, camera.width), draw(st.sampled_from([6, 4, 8]))
    right = np.arange(camera.width) >= column
    kind = draw(st.sampled_from(("object", *MASK_KINDS)))
    parts = (
        Mask.from_bitmap(bitmap & side, kind=kind, embedding=whole.embedding, caption=caption)
        for side, caption in zip((~right, right), captions, strict=True)
    )
    return whole, *parts


@st.composite
def depths(draw: st.DrawFn) -> NDArray[np.uint16]:
    """Mostly a wall; or two with a step between, and pixels that measured nothing or the farthest."""
    depth = np.full((HEIGHT, WIDTH), draw(st.sampled_from([1000, 1000, 1000, 1333, 700, 65535, 0])), np.uint16)
    if draw(st.booleans()):
        depth[:, draw(st.integers(0, WIDTH)) :] = draw(st.sampled_from([1050, 1600, 0]))
        for u0, v0, u1, v1 in draw(st.lists(rectangles(CAMERA), max_size=1)):
            depth[v0:v1, u0:u1] = draw(st.sampled_from([800, 1000, 65535, 0]))
    return depth


def poses() -> st.SearchStrategy[Pose]:
    """Around one place, seldom kilometres away: a step aside, a turn about any axis."""
    angle = st.sampled_from([0.0, 0.0, 0.0, 0.05, -0.3, math.pi])
    axis = st.sampled_from([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.6, 0.8)])
    place = st.tuples(*[st.sampled_from([0.0, 0.0, 0.0, 0.1, -0.07, -1.25])] * 3)
    return st.builds(
        lambda angle, axis, place: Pose(
            (*(math.sin(angle / 2) * a for a in axis), math.cos(angle / 2)),  # type: ignore[arg-type]
            place,
        ),
        angle,
        axis,
        place,
    )


def rigs() -> st.SearchStrategy[Rig]:
    """One registered camera, or two: the same picture from beside, another lens behind a small turn."""
    beside = Pose((0.0, 0.0, 0.0, 1.0), (0.1, 0.0, -0.02))
    turned = Pose((0.0, math.sin(0.05), 0.0, math.cos(0.05)), (-0.03, 0.01, 0.0))
    one = Rig(CAMERA, CAMERA)
    return st.sampled_from([one, one, Rig(CAMERA, CAMERA, beside), Rig(CAMERA, COLOR_CAMERA, turned)])


@st.composite
def parameters(draw: st.DrawFn) -> MapperParameters:
    """A preset, or any switches (what rests on a switch that is off is off, too) and numbers."""
    chosen = small(draw(st.sampled_from([OPENVOX, PAPER, OFFICIAL])))
    if chosen.evolution.background is False and draw(st.booleans()):
        chosen = updated(chosen, {"evolution.veto": True}, source="test")
    off = draw(st.one_of(st.just([]), st.lists(st.sampled_from(SWITCHES), unique=True, max_size=4)))
    out = updated(chosen, dict.fromkeys(off, False), source="test")
    numbers: dict[str, list[Any]] = {
        "map.voxel_size": [0.1, 0.1, 0.25],
        "map.max_depth": [6.0, 65.0],
        "masks.min_pixels": [0, 0, 4],
        "masks.erosion": [0, 0, 1, 2],
        "masks.step_margin": [0, 1, 2],
        "association.threshold": [0.4, 0.1, 0.8],
        "association.hidden_evidence": [1, 4],
        "evolution.halving": [100, 3, 1, 0],
        "evolution.cut_share": [0.03, 0.3],
        "evolution.cut_inheritance": [4.0, 1.0, 0.0],
        "evolution.cut_least": [20, 0, 3],
        "evolution.near": [6.0, 0.0, 2.5],
        "lifecycle.contradiction": [1.0, 1.5],
        "lifecycle.nested": [0.3, 0.7],
        "lifecycle.halving": [200, 3, 10],
        "finish.smoothing": [0, 1, 3],
        "finish.rounds": [0, 1, 2],
        "masks.window": [0, 1],
        "association.slots": [0, 1, 2],
        "finish.ranking": ["share", "matches", "existence", "overlap"],
        "finish.holes": [0.0, 0.1, 0.5],
        "finish.min_votes": [0, 2],
        "finish.min_frames": [0, 2],
        "finish.min_part": [0.05, 0.4],
        "finish.min_confidence": [0.0, 0.12],
    }
    values = {name: draw(st.sampled_from(choices)) for name, choices in numbers.items()}
    for group in fields(out):
        inside = {name.partition(".")[2]: v for name, v in values.items() if name.startswith(group.name + ".")}
        out = replace(out, **{group.name: replace(getattr(out, group.name), **inside)})
    return out


@st.composite
def worlds(draw: st.DrawFn) -> World:
    """Up to 18 frames of one or two scenes; lists of masks come again, among them a whole or its parts."""
    rig, dimensions = draw(rigs()), draw(st.sampled_from([0, 2, 3]))
    far = draw(st.sampled_from([0.0, 0.0, 0.0, -30_000.0]))
    known = draw(st.lists(masks(rig.color, dimensions), min_size=1, max_size=4))
    whole, left, right = draw(halves(rig.color, dimensions))
    others = st.lists(st.sampled_from([*known, whole, left, right]), max_size=5).map(tuple)
    parts = draw(st.sampled_from([(left, right), (left, right, known[0])]))
    story: list[Masks] = draw(st.sampled_from([[(whole,), parts], [parts, (whole,)], [(whole,), parts, (whole,)], []]))
    story = story + draw(st.lists(st.one_of(others, st.none()), min_size=0 if story else 1, max_size=3))
    scenes = draw(st.lists(st.tuples(depths(), poses()), min_size=1, max_size=2))
    scenes = [scenes[0], *scenes]
    seen: list[Masks] = []
    for found in story:
        seen += [found] * draw(st.sampled_from([1, 2, 2, 3]))
    frames = []
    for index, found in enumerate(seen):
        depth, pose = draw(st.sampled_from(scenes))
        x, y, z = pose.translation
        frames.append((wall(index, depth, Pose(pose.quaternion, (x + far, y - far, z)), rig), found))
    return World(tuple(frames), draw(parameters()))
