"""Pieces that every report has: figures at the top, the scenes, tables, parameters and digests."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from openvox.core.mapper_parameters import MapperParameters
from openvox.core.parameters import describe
from openvox.core.types import InstanceMap
from openvox.view.page.document import Html, joined, tag

Color = tuple[int, int, int]
_HEADING = re.compile("<h2>(.*?)</h2>")  # texts are escaped: no caption can look like one


@dataclass(frozen=True)
class Column:
    """A column of a table. number: sorted by value, and set to the right. down: sorted from the largest at first."""

    title: str
    number: bool = False
    down: bool = False
    sorts: bool = True


def head(title: str, lead: str, facts: Iterable[tuple[str, Any]]) -> Html:
    """Title, a sentence, and the figures that one wants first."""
    figures = [tag("div", tag("dt", name), tag("dd", number(value))) for name, value in facts]
    return tag("header", tag("h1", title), tag("p", lead), tag("dl", figures, class_="facts"))


def number(value: Any) -> str:
    """A figure for people: thousands apart, at most three decimals."""
    if value is None:
        return "\u2013"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return f"{value:,}".replace(",", " ")
    return f"{value:.3f}".rstrip("0").rstrip(".") if isinstance(value, float) else str(value)


def with_contents(main: Iterable[Any]) -> Html:
    """A page's content after links to its headings, each of which gets an id."""
    content = joined(main)
    titles = _HEADING.findall(content)
    numbers = iter(range(len(titles)))
    content = Html(_HEADING.sub(lambda found: f'<h2 id="part-{next(numbers)}">{found[1]}</h2>', content))
    links = [tag("a", Html(title), href=f"#part-{i}") for i, title in enumerate(titles)]
    return tag("main", tag("nav", links, class_="contents", aria_label="Contents") if len(links) > 1 else None, content)


def notes(texts: Iterable[str]) -> list[Html]:
    """What the reader should know, a paragraph each."""
    return [tag("p", text, class_="note") for text in texts]


def swatch(color: Color) -> Html:
    """A small square of a colour."""
    square = tag("rect", width=14, height=14, rx=3, fill="#%02x%02x%02x" % color)  # noqa: UP031
    return tag("svg", square, viewBox="0 0 14 14", aria_hidden="true")


def scenes(titles: Sequence[str], modes: Sequence[tuple[str, str]], hint: str, legend: Html | None = None) -> Html:
    """Room for one drawn map a title. modes: name and words of each colouring."""
    frames = [
        tag(
            "div",
            tag("canvas", id=f"scene-{k}", tabindex=0, role="img", aria_label=f"The map {title}, to be turned".strip()),
            tag("h3", title) if title else None,
            class_="frame",
        )
        for k, title in enumerate(titles)
    ]
    walls = [("1", "cut away"), ("0", "all"), ("2", "none")]
    actions = [
        ("closer", "+", "Closer"),
        ("further", "\u2212", "Further"),
        ("above", "Above", ""),
        ("home", "Reset", ""),
    ]
    buttons = [tag("button", text, type="button", data_do=do, aria_label=name or None) for do, text, name in actions]
    bar = (
        tag("label", "Colour", _choice("mode", modes)),
        tag("label", "Walls", _choice("walls", walls)),
        tag("span", buttons, class_="buttons"),
    )
    ramp = tag("div", "unsure", tag("span", class_="ramp"), "sure", class_="legend confidence")
    missing = "This browser cannot draw the map in 3D (it has no WebGL 2); what follows works without it."
    return tag(
        "section",
        tag("div", frames, class_="pair two" if len(titles) > 1 else "pair"),
        tag("div", bar, class_="bar"),
        tag("p", id="status", aria_live="polite", data_hint=hint),
        ramp,
        legend,
        tag("p", missing, class_="note", id="no-scene", hidden=True),
        tag("noscript", tag("p", "Scripts are off: nothing turns, sorts or searches here.", class_="note")),
        id="scenes",
        aria_label="The map in 3D",
    )


def _choice(name: str, options: Sequence[tuple[str, str]]) -> Html:
    return tag("select", [tag("option", words, value=value) for value, words in options], data_set=name)


def searched(
    name: str, title: str, columns: Sequence[Column], rows: Sequence[Html], what: str, *, cards: bool = False
) -> Html:
    """A table under its heading that can be sorted and searched. name: its id. what: its rows, as in "instances".

    cards: on a phone a row is a card, its cells named by their data-label."""
    field = tag("input", type="search", placeholder=f"Search {what}", data_table=name, data_count=f"{name}-count")
    search = (
        tag("label", tag("span", f"Search {what}", class_="hidden"), field),
        tag("output", id=f"{name}-count", aria_live="polite"),
    )
    heads = [
        tag(
            "th",
            tag("button", c.title, type="button") if c.sorts else c.title,
            scope="col",
            data_kind="number" if c.number else None,
            data_first="down" if c.down else None,
        )
        for c in columns
    ]
    table = tag(
        "table",
        tag("thead", tag("tr", heads)),
        tag("tbody", rows),
        id=name,
        class_="sorted cards" if cards else "sorted",
    )
    return tag("section", tag("h2", title), tag("div", search, class_="search"), tag("div", table, class_="scroll"))


def pairs(rows: Iterable[tuple[str, Any, bool]]) -> Html:
    """Name and value, one a line; marked where the third says so."""
    lines = [
        tag("tr", tag("th", name, scope="row"), tag("td", tag("code", value)), class_="changed" if mark else None)
        for name, value, mark in rows
    ]
    return tag("table", tag("tbody", lines), class_="plain")


def provenance(result: InstanceMap, digest: str) -> list[Html]:
    """What the map was made from and with: parameters (those that differ from the default marked), then digests."""
    meta = result.meta
    default = {row.name: row.default for row in describe(MapperParameters())}
    used = meta.get("parameters") if isinstance(meta.get("parameters"), Mapping) else {}
    rows = [(str(name), number(value), default.get(name) != value) for name, value in sorted((used or {}).items())]
    differ = sum(mark for _, _, mark in rows)
    digests = meta.get("digests") if isinstance(meta.get("digests"), Mapping) else {}
    made = [(f"{name} digest", str(value), False) for name, value in sorted({**(digests or {}), "map": digest}.items())]
    names = ("preset", "engine", "encoder", "recording", "perception", "openvox_version", "format_version")
    made += [(name.replace("_", " "), str(meta[name]), False) for name in names if name in meta]
    return [
        tag("h2", "Parameters"),
        *notes([f"{differ} of {len(rows)} differ from the default." if rows else "The map names no parameters."]),
        tag("details", tag("summary", "All parameters"), pairs(rows)) if rows else Html(""),
        pairs([row for row in rows if row[2]]) if differ else Html(""),
        tag("h2", "Where it comes from"),
        pairs(made),
    ]
