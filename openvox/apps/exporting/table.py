"""csv: a row for each instance, for spreadsheets."""

from __future__ import annotations

import csv
from pathlib import Path

from openvox.apps.described import described
from openvox.core.types import InstanceMap

_FORMULA = ("=", "+", "-", "@")
"""A cell that begins so is run as a formula by spreadsheets."""


def write_table(path: Path, result: InstanceMap) -> None:
    """One row an instance, after a header."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = ["id", "caption", "state", "observations", "confidence", "voxels", "first_frame", "last_frame"]
        places = [f"{what}_{axis}" for what in ("center", "min", "max") for axis in "xyz"]
        writer.writerow([*names, *places])
        for one in described(result):
            low, high = one["bounds"]
            texts = [one["instance"], _cell(one["caption"]), *(one[name] for name in names[2:])]
            writer.writerow([*texts, *one["center"], *low, *high])


def _cell(text: str) -> str:
    """A text on one line that a spreadsheet shows and does not run."""
    text = " ".join(text.split())
    return f"'{text}" if text.startswith(_FORMULA) else text
