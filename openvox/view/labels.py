"""Masks and instances as label images with names: what the pictures on screen and on paper have in common."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.core.colors import instance_color
from openvox.core.types import InstanceMap, Mask, Step

NOTHING = -1
CAPTIONS, CAPTION_LETTERS = 3, 32
"""Captions that are told with their votes, and letters of each."""
PICTURE_LETTERS = 14
ARTICLES = re.compile(r"^(there is )?(an?|the)\s+", re.IGNORECASE)
UNASSIGNED = (160, 160, 160)
"""Colour of a mask that went to no instance."""
BACKGROUND = (70, 72, 78)
"""Colour of voxels that belong to no instance."""


@dataclass(frozen=True, slots=True)
class Label:
    """What one value of a label image stands for."""

    text: str
    color: tuple[int, int, int]
    short: str = ""
    """To stand in a picture."""


def mask_image(masks: Sequence[Mask], height: int, width: int) -> NDArray[np.int32]:
    """Number of the smallest mask at each colour pixel (the lower number among equals), -1 = none."""
    image = np.full((height, width), NOTHING, np.int32)
    for number in sorted(range(len(masks)), key=lambda number: (-masks[number].area, -number)):
        x0, y0, x1, y1 = masks[number].box
        image[y0:y1, x0:x1][masks[number].crop()] = number
    return image


def detected_labels(masks: Sequence[Mask], instance_of: Mapping[int, int]) -> dict[int, Label]:
    """Number of each mask to its caption, in the colour of its instance. instance_of: by mask, 0 or absent = none."""
    labels = {}
    for number, mask in enumerate(masks):
        instance = instance_of.get(number, 0)
        caption = mask.caption or mask.label
        color = instance_color(instance) if instance else UNASSIGNED
        where = instance or "nothing"
        short = f"{number}: {shortened(ARTICLES.sub('', caption), PICTURE_LETTERS)} → {where}"
        labels[number] = Label(f"mask {number}: {caption} → {where}", color, short)
    return labels


def caption_votes(captions: Sequence[tuple[str, float]]) -> list[str]:
    """Captions with their votes, as in `a chair (3)`, and how many more there are."""
    shown = [f"{shortened(caption, CAPTION_LETTERS)} ({votes:.4g})" for caption, votes in captions[:CAPTIONS]]
    return shown + ([f"{len(captions) - CAPTIONS} more"] if len(captions) > CAPTIONS else [])


def instance_labels(instances: Sequence[int], caption_of: Callable[[int], str]) -> dict[int, Label]:
    """Id of each instance (0 = background) to its caption and colour."""
    return {
        instance: Label(f"{instance}: {caption_of(instance)}", instance_color(instance))
        if instance
        else Label("background", BACKGROUND)
        for instance in instances
    }


def present(image: NDArray[np.int32]) -> list[int]:
    """The values >= 0 in an image, ascending."""
    return np.flatnonzero(np.bincount(image.ravel() + 1)[1:]).tolist()


def shortened(text: str, length: int) -> str:
    """The text on one line, cut with an ellipsis after so many characters."""
    line = " ".join(text.split())
    return line if len(line) <= length else line[: length - 1].rstrip() + "…"


class Captions:
    """Which captions each instance was given so far, and in how many frames a mask went to it."""

    def __init__(self, earlier: InstanceMap | None = None) -> None:
        self._counts: dict[int, dict[str, float]] = {}  # by the instance that was chosen, which has a fragment's id
        self._frames: dict[int, int] = {}
        self._parts: dict[int, list[int]] = {}
        for summary in earlier.instances if earlier else ():
            self._counts[summary.id] = dict(summary.captions)
            self._frames[summary.id] = summary.observations

    def add(self, step: Step) -> None:
        """Count the captions of this frame's masks; instances that merged share theirs until they part."""
        for decision in step.decisions:
            if decision.instance:
                counts = self._counts.setdefault(decision.instance, {})
                caption = step.masks[decision.mask].caption
                if caption:
                    counts[caption] = counts.get(caption, 0) + 1
        for instance in {decision.instance for decision in step.decisions}:
            self._frames[instance] = self._frames.get(instance, 0) + 1
        self._parts = {}
        for chosen in self._counts:
            self._parts.setdefault(step.instance_of.get(chosen, chosen), []).append(chosen)

    def votes(self, instance: int) -> list[tuple[str, float]]:
        """Captions and how often each was given, most first, then by the alphabet."""
        total: dict[str, float] = {}
        for chosen in self._parts.get(instance, []):
            for caption, count in self._counts[chosen].items():
                total[caption] = total.get(caption, 0) + count
        return sorted(total.items(), key=lambda item: (-item[1], item[0]))

    def observations(self, instance: int) -> int:
        """Frames in which a mask went to it, or to what has merged into it."""
        return sum(self._frames.get(chosen, 0) for chosen in self._parts.get(instance, []))

    def first(self, instance: int) -> str:
        """The caption that its own masks had most often, without those that merged into it; also where it is gone."""
        counts = self._counts.get(instance, {})
        return min(counts, key=lambda caption: (-counts[caption], caption), default="")

    def of(self, instance: int) -> str:
        """The caption given most often, or nothing if no mask had one."""
        return next((caption for caption, _ in self.votes(instance)), "")
