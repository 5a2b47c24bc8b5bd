"""Results for people: tables on stdout. With --json the same result as one JSON object instead."""

from __future__ import annotations

import dataclasses
import json
import math
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

Data = Mapping[str, Any]


def show(result: Any, as_json: bool, table: Callable[[Data], None], *next_step: str | Path) -> None:
    """Print a result: JSON, or the table and, word by word, the command that one would likely run next."""
    data = plain(result)
    if as_json:
        print(json.dumps(data, allow_nan=False))
        return
    table(data)
    if next_step:
        print(f"next: {shlex.join(str(word) for word in next_step)}")


def plain(value: Any) -> Any:
    """What JSON knows: dataclasses and mappings as objects, paths as text, what is no finite number as null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def print_table(columns: Sequence[str], rows: Iterable[Sequence[Any]], title: str = "") -> None:
    """Numbers to the right, everything else to the left."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    cells = [list(row) for row in rows]
    table = Table(title=title or None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for i, name in enumerate(columns):
        numbers = [row[i] for row in cells if row[i] is not None]
        right = bool(numbers) and all(isinstance(value, (int, float)) for value in numbers)
        table.add_column(name, justify="right" if right else "left")
    for row in cells:
        table.add_row(*(Text(cell(value)) for value in row))
    console = Console(highlight=False)
    if console.is_terminal:
        console.print(table)
        return
    console.width = 140  # a file or a pipe has no edge to wrap at; 80 would cut captions
    with console.capture() as printed:
        console.print(table)
    print("\n".join(line.rstrip() for line in printed.get().splitlines()))


def cell(value: Any) -> str:
    """One value as text; control characters, which a caption from a file could hold, are shown as `?`."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, (list, tuple)):
        return ", ".join(cell(item) for item in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {cell(item)}" for key, item in value.items())
    return "".join(letter if letter.isprintable() else "?" for letter in str(value))


INLINE = 90
"""Characters up to which a nested object stays on its line."""


def pairs(data: Data) -> None:
    """Name and value, one a line, nested objects indented."""
    _print_pairs(data, "")


def _print_pairs(data: Data, indent: str) -> None:
    width = max((len(str(key)) for key in data), default=0)
    for key, value in data.items():
        name = str(key) if "." in str(key) else str(key).replace("_", " ")  # a parameter keeps its name
        if isinstance(value, list) and value and isinstance(value[0], Mapping):
            print_table(list(value[0]), [list(row.values()) for row in value], name)
        elif isinstance(value, Mapping) and len(cell(value)) > INLINE:
            print(f"{indent}{name}")
            _print_pairs(value, indent + "  ")
        else:
            print(f"{indent}{name:<{width}}  {cell(value) or '-'}")


def notes(data: Data) -> None:
    """What a person should know beside the result."""
    for note in data["notes"]:
        print(f"note: {cell(note)}")


def wrote(path: str, replaced: bool = False) -> None:
    """The file that a command made."""
    print(f"wrote {path}{' (an older file of that name was replaced)' if replaced else ''}")
