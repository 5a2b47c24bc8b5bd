"""What a map answered, shown in it: the answers in a colour that nothing else has, everything else in grey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from openvox.core.types import InstanceMap
from openvox.view.labels import shortened
from openvox.view.lettering import HALO, write
from openvox.view.pictures import MARGIN, PAPER, TITLE, map_azimuth, map_picture, write_png

BEST = (226, 74, 18)
NEXT = (246, 178, 107)
REST = (164, 167, 175)
WIDTH, HEIGHT = 1280, 800
TEXT = 90
"""Letters of a question in a title."""


@dataclass(frozen=True, slots=True)
class Answered:
    """A question and the instances that fit it, best first."""

    text: str
    found: bool
    """The best one fits well."""
    instances: tuple[int, ...]
    names: tuple[str, ...]
    """Their scores and captions."""

    def color(self, instance: int) -> tuple[int, int, int]:
        """Of an instance in the picture of this question."""
        if instance not in self.instances:
            return REST
        return BEST if instance == self.instances[0] else NEXT

    @property
    def title(self) -> str:
        """The question, and whether it was answered."""
        text = shortened(self.text, TEXT)
        return text if self.found else f"{text} (nothing fits well; the nearest are shown)"


def draw_answers(out: Path, result: InstanceMap, answered: Sequence[Answered]) -> None:
    """A PNG with a picture a question, one below the other: the best answer orange, further ones pale.

    Each from the side that shows the answers best. Raises OutputError."""
    rows = len(answered) * (TITLE + HEIGHT + MARGIN)
    sheet = np.full((rows, WIDTH + 2 * MARGIN, 3), PAPER, np.uint8)
    for number, one in enumerate(answered):
        top = number * (TITLE + HEIGHT + MARGIN) + TITLE
        sheet[top : top + HEIGHT, MARGIN : MARGIN + WIDTH] = map_picture(
            result,
            map_azimuth(result, one.instances),
            width=WIDTH,
            height=HEIGHT,
            color_of=one.color,
            names=dict(zip(one.instances, one.names, strict=True)),
        )
        write(sheet, one.title, (MARGIN, top - 11), scale=0.6, color=HALO, halo=0)
    write_png(out, sheet)
