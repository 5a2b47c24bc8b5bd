"""A colour for every instance: the same in every view and export, and far from that of its neighbours by id."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

GREY = (150, 150, 150)
"""Background, and whatever belongs to no instance."""
_GOLDEN = 0.618033988749895
_SATURATION = (0.75, 0.5, 0.95)
_VALUE = (0.95, 0.75)


def instance_color(instance: int) -> tuple[int, int, int]:
    """Red, green, blue, 0 .. 255. Hues go round by the golden angle; ids below 1 are grey."""
    if instance < 1:
        return GREY
    hue = instance * _GOLDEN % 1.0
    red, green, blue = colorsys.hsv_to_rgb(hue, _SATURATION[instance % 3], _VALUE[instance // 3 % 2])
    return round(255 * red), round(255 * green), round(255 * blue)


def category_colors(categories: Sequence[str]) -> list[tuple[int, int, int]]:
    """A colour for each, the same for the same name; names take colours in alphabetical order."""
    place = {name: number for number, name in enumerate(sorted(set(categories)), 1)}
    return [instance_color(place[name]) for name in categories]
