"""The decisions most likely wrong, as `explain --suspicious` lists them, each with a way to its instance."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

from openvox.apps.reporting.parts import Column, notes, searched, swatch
from openvox.core.colors import instance_color
from openvox.view.page.document import Html, tag

COLUMNS = (
    Column("Rank", number=True),
    Column("Instance", number=True),
    Column("Frame", number=True),
    Column("Mask", number=True),
    Column("Score", number=True, down=True),
    Column("Why", sorts=False),
)


def first_look(found: Mapping[str, Any], known: Container[int]) -> list[Html]:
    """found: what `suspicious` says. known: instances that have a row to go to."""
    if not found["decisions"]:
        return []
    rows = [_row(rank, one, known) for rank, one in enumerate(found["decisions"], start=1)]
    about = f"The decisions most likely wrong, worst first. {found['rule'][0].upper()}{found['rule'][1:]}."
    more = "openvox explain TRACE --frame N --mask M tells all about one of them."
    table = searched("suspects", "Where to look first", COLUMNS, rows, "these decisions", cards=True)
    return [table, *notes([about, more])]


def _row(rank: int, one: Mapping[str, Any], known: Container[int]) -> Html:
    instance = one["instance"]
    name = (swatch(instance_color(instance)), instance)
    place = tag("a", name, href=f"#instance-{instance}") if instance in known else instance
    cells = ((None, rank), ("instance", instance), ("frame", one["frame"]), ("mask", one["mask"]))
    why = tag("span", one["caption"] or "no caption", class_="caption"), tag("span", one["reason"], class_="also")
    return tag(
        "tr",
        [
            tag("td", place if label == "instance" else value, class_="number", data_value=value, data_label=label)
            for label, value in cells
        ],
        tag("td", f"{one['score']:.2f}", class_="number", data_value=f"{one['score']:.6g}", data_label="score"),
        tag("td", why, class_="wrap wide"),
    )
