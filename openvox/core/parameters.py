"""Parameters: each stands once, as a field of a frozen dataclass, with unit, range, default and reason.

A *group* is a frozen dataclass whose fields are made by `parameter`. A *set* is a frozen dataclass whose fields are
groups. Names are dotted: `association.threshold`. Precedence: preset < file < --set.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from openvox.core.errors import InputError

Value = bool | int | float | str
Set = TypeVar("Set")
PURE = ("IoU", "confidence", "cosine", "factor", "number", "probability", "score", "share", "weight")
"""Units that say what a number means and are not said after it."""


def parameter(
    default: Value,
    unit: str,
    low: float | None = None,
    high: float | None = None,
    *,
    why: str,
    choices: tuple[str, ...] = (),
    needs: str = "",
    without: str = "",
) -> Any:
    """A field of a group. `needs`: dotted name of the switch without which this parameter has no effect; `without`: of
    the switch with which it has none."""
    return dataclasses.field(
        default=default,
        metadata={
            "unit": unit,
            "low": low,
            "high": high,
            "why": why,
            "choices": choices,
            "needs": needs,
            "without": without,
        },
    )


@dataclasses.dataclass(frozen=True, slots=True)
class Description:
    """One row of `openvox info --parameters`."""

    name: str
    default: Value
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    needs: str
    without: str
    why: str

    @property
    def range(self) -> str:
        """What the value may be, for people."""
        if self.choices:
            return " | ".join(self.choices)
        if isinstance(self.default, bool):
            return "true | false"
        return f"{self.low:.15g} .. {self.high:.15g}" if self.low is not None and self.high is not None else ""


def describe(parameters: Any) -> list[Description]:
    """All parameters of a set, in order of definition; the defaults are those of the groups, whatever the set holds."""
    return [
        Description(name=f"{group.name}.{field.name}", default=_default(field), **field.metadata)
        for group in dataclasses.fields(parameters)
        for field in dataclasses.fields(getattr(parameters, group.name))
    ]


def _default(field: dataclasses.Field[Any]) -> Value:
    assert isinstance(field.default, (bool, int, float, str)), field.name
    return field.default


def as_dict(parameters: Any) -> dict[str, Value]:
    """Dotted name to value, in order of definition."""
    return {
        f"{group.name}.{field.name}": getattr(getattr(parameters, group.name), field.name)
        for group in dataclasses.fields(parameters)
        for field in dataclasses.fields(getattr(parameters, group.name))
    }


def updated(parameters: Set, changes: Mapping[str, Value], *, source: str) -> Set:
    """A copy of the set with some values replaced, each checked.

    changes: dotted name to value; text is read as the parameter's type. source: named in errors (a file, "--set").
    What rests on a switch that is off is switched off with it. Raises InputError, also where a change has no effect.
    """
    described = {row.name: row for row in describe(parameters)}
    values = as_dict(parameters)
    for name, raw in changes.items():
        if name not in described:
            near = difflib.get_close_matches(name, described, n=1)
            hint = f"; did you mean {near[0]}?" if near else "; openvox info --parameters lists all"
            raise InputError(f"{source}: there is no parameter {name!r}{hint}")
        values[name] = _checked(described[name], raw, source)
    _switch_off(described, values)
    for name in changes:
        needs = described[name].needs
        if needs and not values[needs] and _checked(described[name], changes[name], source) is not False:
            raise InputError(
                f"{source}: {name} has no effect here, because {needs} is off; "
                f"set {needs}=true as well, or leave it out"
            )
        without = described[name].without
        if without and values[without] and _checked(described[name], changes[name], source) is not False:
            raise InputError(
                f"{source}: {name} has no effect here, because {without} is on; "
                f"set {without}=false as well, or leave it out"
            )
    groups = {}
    for group in dataclasses.fields(parameters):  # type: ignore[arg-type]
        old = getattr(parameters, group.name)
        groups[group.name] = dataclasses.replace(
            old, **{field.name: values[f"{group.name}.{field.name}"] for field in dataclasses.fields(old)}
        )
    return dataclasses.replace(parameters, **groups)  # type: ignore[type-var]


def _switch_off(described: Mapping[str, Description], values: dict[str, Value]) -> None:
    """Turn off every switch whose own switch is off, or that another one replaces, and what rests on those in turn."""
    while True:
        off = [
            name
            for name, row in described.items()
            if values[name] is True and ((row.needs and not values[row.needs]) or (row.without and values[row.without]))
        ]
        if not off:
            return
        values.update(dict.fromkeys(off, False))


def _checked(row: Description, raw: Value, source: str) -> Value:
    value = _parsed(row, raw, source)
    if row.choices and value not in row.choices:
        raise InputError(f"{source}: {row.name} is {value!r}; expected one of {', '.join(row.choices)}")
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        low = -math.inf if row.low is None else row.low
        high = math.inf if row.high is None else row.high
        if not (math.isfinite(value) and low <= value <= high):
            unit = "" if row.unit in PURE else f" {row.unit}"
            raise InputError(f"{source}: {row.name} is {value:g}{unit}; expected {row.range}")
    return value


def _parsed(row: Description, raw: Value, source: str) -> Value:
    kind = type(row.default)
    if kind is bool:
        words = {"true": True, "false": False, "on": True, "off": False, "1": True, "0": False}
        if isinstance(raw, bool):
            return raw
        if isinstance(raw, str) and raw.lower() in words:
            return words[raw.lower()]
    elif kind is str:
        if isinstance(raw, str):
            return raw
    elif not isinstance(raw, bool):
        try:
            number = float(raw)
        except (ValueError, OverflowError):
            number = math.nan
        if not math.isnan(number) and (kind is float or number.is_integer()):
            return kind(number)
    expected = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}[kind]
    raise InputError(f"{source}: {row.name} is {raw!r}; expected {expected}")


def from_toml(path: Path) -> dict[str, Value]:
    """Dotted names and values of a TOML file with one table a group. Raises InputError."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; --params wants a TOML file with one table a group") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: cannot be read as TOML ({error})") from None
    flat: dict[str, Value] = {}
    for group, table in tables.items():
        if not isinstance(table, dict):
            raise InputError(f"{path}: {group!r} stands outside a table; expected [group] and then key = value")
        for key, value in table.items():
            if not isinstance(value, (bool, int, float, str)):
                raise InputError(f"{path}: {group}.{key} is {value!r}; expected a number, a text, true or false")
            flat[f"{group}.{key}"] = value
    return flat


def from_assignments(assignments: Iterable[str], option: str = "--set") -> dict[str, Value]:
    """`group.key=value` texts of the command line. Raises InputError."""
    flat: dict[str, Value] = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise InputError(f"{option} {text!r}: expected group.key=value, as in association.threshold=0.3")
        if name.strip() in flat:
            raise InputError(f"{option}: {name.strip()} is given twice; give it once")
        flat[name.strip()] = value.strip()
    return flat
