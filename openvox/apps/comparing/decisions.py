"""The first decision that differs between two traces. Reading stops there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

from openvox.core.fixedpoint import Q20
from openvox.formats.trace import read_decisions

FIELDS = (
    *("mask", "voxels", "candidates", "by", "held", "fragment", "instance", "abstained"),
    *("s_geo", "s_fea", "a", "visibility", "credibility", "threshold"),
)
"""What a decision is made of, causes before their effects: where several fields differ, the first is named."""
OUTCOME = ("by", "held", "fragment", "instance")
"""Where a mask went, whatever the scores."""
UNITS = {"s_geo": Q20, "s_fea": Q20, "a": Q20, "threshold": Q20, "visibility": Q20, "credibility": 4096}
CANDIDATE = ("instance", "overlap", "s_geo", "s_fea", "a")
NOTHING: Mapping[str, Any] = {}


@dataclass(frozen=True, slots=True)
class Difference:
    """One field that differs; a and b are its values. Scores as numbers in [0, 1]."""

    frame: int
    mask: int | None
    """None where the frames themselves differ: `frame` (one trace lacks it), `looked`, `masks` (their number)."""
    field: str
    a: Any
    b: Any
    caption: str = ""
    """Of the mask in a, for people."""


def first_difference(a: Path, b: Path, fields: Sequence[str], start: int = 0) -> Difference | None:
    """The first frame, mask and field in which two traces differ, from frame `start` on; None if they do not.

    Raises InputError."""
    for one, other in zip_longest(read_decisions(a, start), read_decisions(b, start)):
        found = next(_in_frame(one, other, fields), None)
        if found is not None:
            return found
    return None


def _in_frame(
    one: Mapping[str, Any] | None, other: Mapping[str, Any] | None, fields: Sequence[str]
) -> Iterator[Difference]:
    a, b = (None if frame is None else int(frame["frame"]) for frame in (one, other))
    first = min(number for number in (a, b) if number is not None)
    if one is None or other is None or a != b:
        yield Difference(first, None, "frame", a, b)
        return
    if one["looked"] != other["looked"]:
        yield Difference(first, None, "looked", one["looked"], other["looked"])
    for row, pair in enumerate(zip(one["decisions"], other["decisions"], strict=False)):
        for field in fields:
            if pair[0].get(field) != pair[1].get(field):
                where, values = _values(field, *(decision.get(field) for decision in pair))
                yield Difference(first, row, where, *values, caption=str(pair[0].get("caption", "")))
    counts = len(one["decisions"]), len(other["decisions"])
    if counts[0] != counts[1]:
        yield Difference(first, None, "masks", *counts)


def _values(field: str, a: Any, b: Any) -> tuple[str, tuple[Any, Any]]:
    """The field's name and both values; of candidates, the first value in the list that differs."""
    if field != "candidates":
        return field, (_number(field, a), _number(field, b))
    for place, (one, other) in enumerate(zip_longest(a or (), b or (), fillvalue=NOTHING)):
        for name in CANDIDATE:
            if one.get(name) != other.get(name):
                return f"candidates[{place}].{name}", (_number(name, one.get(name)), _number(name, other.get(name)))
    return field, (a, b)


def _number(field: str, value: Any) -> Any:
    return value / UNITS[field] if field in UNITS and isinstance(value, int) else value
