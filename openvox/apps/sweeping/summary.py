"""What the items of a sweep tell together: each set over all recordings, which parameter matters, the best set."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]
MEASURES = ("ap", "f50", "instances", "seconds")
"""For which main effects are told; the first ranks the sets."""
TIE = 0.001
"""Sets whose first measure is less than this behind the best are as good."""
SCORES = (
    *("ap", "ap50", "ap25", "f50", "miou", "spill", "missed_share", "wrong_share"),
    *("predicted", "true", "split", "merged", "missed"),
)


def described_sets(sets: Sequence[Any], items: Sequence[Row]) -> list[dict[str, Any]]:
    """Each set with its means over the recordings that were mapped; scores only if none failed, as else the means of
    two sets would be of different recordings."""
    rows = []
    for one in sets:
        mine = [item for item in items if item["set"] == one.number]
        done = [item for item in mine if item["status"] == "done"]
        scored = [item["scores"] for item in done if item["scores"]]
        rows.append(
            {
                "set": one.number,
                "parameters": dict(one.values),
                "default": one.default,
                "grid": one.grid,
                "items": len(mine),
                "failed": len(mine) - len(done),
                **{name: _mean([item[name] for item in done]) for name in ("seconds", "voxels", "instances")},
                "scores": {name: _mean([score[name] for score in scored]) for name in SCORES}
                if scored and len(scored) == len(mine)
                else None,
            }
        )
    return rows


def effects(varied: Mapping[str, Sequence[Any]], sets: Sequence[Row]) -> list[dict[str, Any]]:
    """The main effect of each parameter on each measure: its mean at each value over the sets of the grid; within a
    measure, the largest range first.

    Only groups of sets that differ in nothing but this parameter, and of which none failed, are counted: else the means
    of two values would be of different sets."""
    rows = []
    for measure in MEASURES:
        of_measure = [_effect(name, values, measure, sets) for name, values in varied.items() if len(values) > 1]
        rows += sorted((row for row in of_measure if row["range"] is not None), key=lambda row: -row["range"])
    return rows


def _effect(name: str, values: Sequence[Any], measure: str, sets: Sequence[Row]) -> dict[str, Any]:
    groups: dict[tuple[Any, ...], dict[Any, float]] = {}
    for one in sets:
        number = measured(one, measure)
        if one["grid"] and number is not None:
            rest = tuple(value for other, value in one["parameters"].items() if other != name)
            groups.setdefault(rest, {})[one["parameters"][name]] = number
    whole = [group for group in groups.values() if len(group) == len(values)]
    means = [{"value": value, "mean": _mean([group[value] for group in whole]), "sets": len(whole)} for value in values]
    numbers = [row["mean"] for row in means if row["mean"] is not None]
    reach = max(numbers) - min(numbers) if numbers else None
    return {"parameter": name, "measure": measure, "means": means, "range": reach}


def best(sets: Sequence[Row]) -> dict[str, Any] | None:
    """The set of the highest first measure, the default among equals, then the lowest number; None without scores."""
    measure = MEASURES[0]
    scored = [one for one in sets if measured(one, measure) is not None]
    if not scored:
        return None
    top = min(scored, key=lambda one: (-one["scores"][measure], not one["default"], one["set"]))
    default = next((measured(one, measure) for one in sets if one["default"]), None)
    least = top["scores"][measure] - TIE
    return {
        "set": top["set"],
        "parameters": top["parameters"],
        "score": top["scores"][measure],
        "default_score": default,
        "ties": [one["set"] for one in scored if one is not top and one["scores"][measure] > least],
    }


def measured(one: Row, measure: str) -> float | None:
    """A measure of a set, of its scores or its own; None if there is none, or an item of the set failed."""
    if one["failed"]:
        return None
    number = (one["scores"] or {}).get(measure) if measure in SCORES else one[measure]
    return None if number is None else float(number)


def table(items: Sequence[Row], varied: Sequence[str]) -> str:
    """The items as CSV, a header first."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    plain = ("item", "name", "recording", "set", "default", "status", "error", "reused", "seconds", "frames", "voxels")
    places = ("frame", "mask", "field")
    writer.writerow(
        [*plain, "instances", *varied, "map_digest", "trace_digest", *SCORES, *(f"first_{place}" for place in places)]
    )
    for item in items:
        digests, scores, first = (item[name] or {} for name in ("digests", "scores", "first_outcome"))
        writer.writerow(
            [
                *(item[name] for name in (*plain, "instances")),
                *(item["parameters"][name] for name in varied),
                *(digests.get(name) for name in ("map", "trace")),
                *(scores.get(name) for name in SCORES),
                *(first.get(place) for place in places),
            ]
        )
    return text.getvalue()


def _mean(numbers: Sequence[float | None]) -> float | None:
    known = [number for number in numbers if number is not None]
    return sum(known) / len(known) if known else None
