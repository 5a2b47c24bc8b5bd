"""Small plots as SVG, drawn for the width of a phone; colours come from the page's style."""

from __future__ import annotations

import math
from collections.abc import Sequence

from openvox.view.page.document import Html, tag

WIDTH, HEIGHT = 340, 190
LEFT, RIGHT, TOP, BOTTOM = 44, 10, 10, 34
"""Margins of the drawing, which hold the numbers at its axes."""
BAR = 24
SERIES = 3
"""Lines that the style has colours for."""
AREAS = 4
COLUMNS = 280
"""Frames that are drawn of a long run."""


def bars(title: str, rows: Sequence[tuple[str, float]], note: str = "", *, digits: int = 0) -> Html:
    """A bar a row, longest = full width, with its name and number."""
    most = max((value for _, value in rows), default=0) or 1
    names = max((len(name) for name, _ in rows), default=0)
    left = min(150, 8 + 6.6 * names)
    room = WIDTH - left - 52
    marks: list[Html] = []
    for i, (name, value) in enumerate(rows):
        y = i * BAR
        length = max(room * value / most, 1 if value else 0)
        marks += [
            _text(left - 6, y + 16, _short(name, 22), "end"),
            _rect(left, y + 4, length, BAR - 8, f"{name}: {_number(value, digits)}"),
            _text(left + length + 6, y + 16, _number(value, digits), "start"),
        ]
    said = ", ".join(f"{name} {_number(value, digits)}" for name, value in rows)
    return _figure(title, note, marks, f"{title}: {said}", max(len(rows), 1) * BAR + 4)


def dots(title: str, rows: Sequence[tuple[str, float]], note: str = "", *, digits: int = 0) -> Html:
    """A dot a row over an axis from the least to the largest number, so that small differences are seen."""
    numbers = [value for _, value in rows]
    low, reach = min(numbers, default=0), max(numbers, default=0) - min(numbers, default=0)
    left = min(150, 14 + 6.6 * max((len(name) for name, _ in rows), default=0))
    room = WIDTH - left - 66
    marks: list[Html] = []
    for i, (name, value) in enumerate(rows):
        y = i * BAR + BAR / 2
        x = left + (room * (value - low) / reach if reach else room / 2)
        marks += [
            _text(left - 10, y + 4, _short(name, 22), "end"),
            tag("line", x1=_f(left), x2=_f(left + room), y1=_f(y), y2=_f(y), class_="grid"),
            tag("circle", tag("title", f"{name}: {_number(value, digits)}"), cx=_f(x), cy=_f(y), r=5),
            _text(left + room + 10, y + 4, _number(value, digits), "start"),
        ]
    said = ", ".join(f"{name} {_number(value, digits)}" for name, value in rows)
    return _figure(title, note, marks, f"{title}: {said}", max(len(rows), 1) * BAR + 4)


def histogram(title: str, values: Sequence[float], low: float, high: float, note: str = "", bins: int = 30) -> Html:
    """How many values lie in each part of low .. high, those beyond it in the outer parts; a line marks 0 if inside."""
    counts = [0] * bins
    for value in values:
        counts[min(bins - 1, max(0, math.floor((value - low) / (high - low) * bins)))] += 1
    top = _ceiling(max(counts, default=0))
    step = (high - low) / bins
    marks = _grid((low, high), top)
    for i, count in enumerate(counts):
        x0, x1 = _x(i, 0, bins), _x(i + 1, 0, bins)
        y = _y(count, top)
        name = f"{low + i * step:.2f} to {low + (i + 1) * step:.2f}: {count}"
        marks.append(_rect(x0 + 0.5, y, x1 - x0 - 1, HEIGHT - BOTTOM - y, name))
    if low < 0 < high:
        zero = _x(0, low, high)
        marks.append(tag("line", x1=_f(zero), x2=_f(zero), y1=TOP, y2=HEIGHT - BOTTOM, class_="mark"))
    return _figure(title, note, marks, f"{title}: {len(values)} values from {low:g} to {high:g}", HEIGHT)


def lines(title: str, x: Sequence[float], series: Sequence[tuple[str, Sequence[float]]], note: str = "") -> Html:
    """Lines over a common axis (frame numbers), each with its name; y begins at 0."""
    top = _ceiling(max((max(y, default=0) for _, y in series), default=0))
    low, high = (min(x), max(x)) if x else (0, 0)
    if low == high:
        high = low + 1
    marks = _grid((low, high), top)
    for number, (_, values) in enumerate(series):
        points = " ".join(f"{_f(_x(a, low, high))},{_f(_y(b, top))}" for a, b in zip(x, values, strict=True))
        marks.append(tag("polyline", points=points, class_=f"line line-{number % SERIES}"))
    keys = (
        [tag("span", name, class_=f"key key-{number % SERIES}") for number, (name, _) in enumerate(series)]
        if len(series) > 1
        else []
    )
    ends = ", ".join(f"{name} ends at {values[-1]:g}" for name, values in series if len(values))
    return _figure(title, note, marks, f"{title}: {ends}", HEIGHT, keys)


def areas(title: str, x: Sequence[float], series: Sequence[tuple[str, Sequence[float]]], note: str = "") -> Html:
    """Values >= 0 on one another over a common axis (frame numbers), each with its name.

    Of many frames the highest of each few that lie together is drawn."""
    few = -(-len(x) // COLUMNS) or 1
    height = [sum(values) for values in zip(*(values for _, values in series), strict=True)]
    kept = [max(range(i, min(i + few, len(x))), key=height.__getitem__) for i in range(0, len(x), few)]
    low, high = (min(x), max(x)) if x else (0, 0)
    high += low == high
    top = _ceiling(max(height, default=0))
    marks = _grid((low, high), top)
    floor = [0.0] * len(kept)
    for number, (_, values) in enumerate(series):
        roof = [below + values[k] for below, k in zip(floor, kept, strict=True)]
        edge = [*zip(kept, roof, strict=True), *reversed([*zip(kept, floor, strict=True)])]
        points = " ".join(f"{_f(_x(x[k], low, high))},{_f(_y(value, top))}" for k, value in edge)
        marks.append(tag("polygon", points=points, class_=f"area-{number % AREAS}"))
        floor = roof
    keys = [tag("span", name, class_=f"key area-key-{number % AREAS}") for number, (name, _) in enumerate(series)]
    said = f"{title}: {', '.join(name for name, _ in series)} on one another, at most {max(height, default=0):.3g}"
    return _figure(title, note, marks, said, HEIGHT, keys)


def _figure(title: str, note: str, marks: Sequence[Html], said: str, height: float, keys: Sequence[Html] = ()) -> Html:
    picture = tag("svg", marks, viewBox=f"0 0 {WIDTH} {_f(height)}", role="img", aria_label=said)
    legend = tag("p", keys, class_="keys") if keys else None
    return tag("figure", tag("figcaption", tag("b", title), tag("span", note) if note else None), picture, legend)


def _grid(across: tuple[float, float], top: float) -> list[Html]:
    """Numbers and thin lines."""
    marks = []
    for i in range(5):
        value = top * i / 4
        y = _y(value, top)
        marks.append(tag("line", x1=LEFT, x2=WIDTH - RIGHT, y1=_f(y), y2=_f(y), class_="grid"))
        if i % 2 == 0:
            marks.append(_text(LEFT - 6, y + 4, _number(value, 0), "end"))
    for i in range(5):
        value = across[0] + (across[1] - across[0]) * i / 4
        anchor = ("start", "middle", "middle", "middle", "end")[i]
        marks.append(
            _text(
                _x(value, *across),
                HEIGHT - BOTTOM + 18,
                f"{value:.4g}" if abs(across[1]) < 10 else f"{value:.0f}",
                anchor,
            )
        )
    return marks


def _x(value: float, low: float, high: float) -> float:
    return LEFT + (WIDTH - RIGHT - LEFT) * (value - low) / (high - low)


def _y(value: float, top: float) -> float:
    return HEIGHT - BOTTOM - (HEIGHT - BOTTOM - TOP) * value / top


def _ceiling(value: float) -> float:
    """The next number of 4, 8, 12, 20, 40 ... that a quarter of is round."""
    scale = 10.0 ** math.floor(math.log10(value / 4)) if value > 4 else 1.0
    return next(4 * scale * step for step in (1, 2, 3, 5, 10) if 4 * scale * step >= value)


def _number(value: float, digits: int) -> str:
    if digits:
        return f"{value:.{digits}f}"
    return f"{value / 1000:g}k" if value >= 10000 and value % 100 == 0 else f"{value:g}"


def _short(text: str, length: int) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"


def _rect(x: float, y: float, width: float, height: float, name: str) -> Html:
    return tag("rect", tag("title", name), x=_f(x), y=_f(y), width=_f(max(width, 0)), height=_f(max(height, 0)))


def _text(x: float, y: float, text: str, anchor: str) -> Html:
    return tag("text", text, x=_f(x), y=_f(y), text_anchor=anchor)


def _f(value: float) -> str:
    """A coordinate, short."""
    return f"{value:.1f}".removesuffix(".0")
