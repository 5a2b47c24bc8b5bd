"""The pictures in which each instance was seen best: crops around its largest masks, and a sheet of them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Frame, Mask, Step
from openvox.formats.images import decode_color

Picture = NDArray[np.uint8]
SIDE = 112
VIEWS = 3
APART = 15
"""Frames between two views of an instance; of nearer ones the better is kept."""
BETTER = 1.25
"""How much larger a mask must be to replace another: pictures are decoded only for these."""
ACROSS = 4
"""Instances side by side in the sheet."""
GAP = 10
PAPER = 24
WIDTH = ACROSS * (VIEWS * SIDE + GAP)
"""Of the sheet, pixels."""


@dataclass(frozen=True, eq=False)
class View:
    """One crop, (SIDE, SIDE, 3) RGB, with the mask's area in pixels, halved if the picture's border cuts it."""

    area: float
    frame: int
    crop: Picture


@dataclass(frozen=True, eq=False)
class Sheet:
    """All instances' views in one picture, with their ids, and the box (x, y, width, height) of each instance there."""

    picture: Picture
    boxes: dict[int, tuple[int, int, int, int]]


class BestViews:
    """Keeps the best views of every instance that a mask went to."""

    def __init__(self) -> None:
        self._views: dict[int, list[View]] = {}  # by the instance that was chosen, which has the id of a fragment

    def add(self, step: Step) -> None:
        """Look whether this frame shows an instance better; without colour nothing happens."""
        picture: Picture | None = None
        for decision in step.decisions if step.frame.color else ():
            mask = step.masks[decision.mask]
            views = self._views.setdefault(decision.instance, [])
            area = _visible(mask, step.frame)
            kept = _kept(views, area, step.frame.index)
            if decision.instance and area and kept is not None:
                picture = decode_color(step.frame) if picture is None else picture
                views[:] = [*kept, View(area, step.frame.index, _crop(picture, mask))]

    def of(self, instance: int) -> Sequence[View]:
        """The views of an instance, as it was called when a mask went to it."""
        return self._views.get(instance, ())

    def strips(self, instances: Sequence[int], now: Callable[[int], int]) -> dict[int, Picture]:
        """The views of those of these instances that have some, side by side, the best first.

        now: instance of a fragment."""
        views: dict[int, list[View]] = {}
        for chosen, seen in self._views.items():
            views.setdefault(now(chosen), []).extend(seen)
        best = {i: sorted(views.get(i, ()), key=lambda view: (-view.area, view.frame))[:VIEWS] for i in instances}
        return {i: np.hstack([view.crop for view in seen]) for i, seen in best.items() if seen}


def sheet(strips: Mapping[int, Picture]) -> Sheet:
    """The views of all these instances, one or more, in rows."""
    width, height = VIEWS * SIDE + GAP, SIDE + GAP
    picture = np.full((-(-len(strips) // ACROSS) * height, WIDTH, 3), PAPER, np.uint8)
    boxes = {}
    for place, (instance, strip) in enumerate(strips.items()):
        x, y = place % ACROSS * width, place // ACROSS * height
        boxes[instance] = (x, y, VIEWS * SIDE, SIDE)
        picture[y : y + SIDE, x : x + strip.shape[1]] = strip
        for color, thick in (((0, 0, 0), 5), ((255, 255, 255), 2)):
            cv2.putText(picture, str(instance), (x + 6, y + 28), cv2.FONT_HERSHEY_SIMPLEX, 0.9, color, thick)
    return Sheet(picture, boxes)


def _kept(views: Sequence[View], area: float, frame: int) -> list[View] | None:
    """The views that stay if a mask of this area comes in; None if it is not better."""
    near = [view for view in views if abs(view.frame - frame) < APART]
    if not near and len(views) < VIEWS:
        return list(views)
    worst = min(near or views, key=lambda view: view.area)
    return [view for view in views if view is not worst] if area > BETTER * worst.area else None


def _visible(mask: Mask, frame: Frame) -> float:
    x0, y0, x1, y1 = mask.box
    cut = x0 == 0 or y0 == 0 or x1 == frame.rig.color.width or y1 == frame.rig.color.height
    return mask.area / 2 if cut else mask.area


def _crop(picture: Picture, mask: Mask) -> Picture:
    """The square around the mask's box, as far as the picture reaches."""
    x0, y0, x1, y1 = mask.box
    half = max(x1 - x0, y1 - y0, 16) * 0.55
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    part = picture[max(0, int(y - half)) : int(y + half) + 1, max(0, int(x - half)) : int(x + half) + 1]
    scale = SIDE / max(part.shape[:2])
    size = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
    small = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    out = np.full((SIDE, SIDE, 3), PAPER, np.uint8)
    top, left = (SIDE - size[1]) // 2, (SIDE - size[0]) // 2
    out[top : top + size[1], left : left + size[0]] = small
    return out
