"""How long each stage of a run took, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from openvox.apps.timing import LATENCY, MAPPING
from openvox.core.errors import InputError
from openvox.formats.times import Times, read_times, times_path
from openvox.view.page.document import Html, tag
from openvox.view.page.plots import areas, lines

STEP = "all four"
COLUMNS = ("milliseconds", "median", "95 %", "longest", "frame")
WORDS = {LATENCY: "latency, arrival to map", "rerun": "drawing for Rerun"}


def times_of(trace: Path, digest: str) -> Times | None:
    """The times beside a trace; None if there are none of this run. digest: the trace's."""
    try:
        times = read_times(times_path(trace))
    except InputError:
        return None  # it was not asked for
    return times if times.trace == digest else None


def speed_section(trace: Path, times: Times | None) -> list[Html]:
    """The stages of the mapper on one another, what runs beside it as lines, and a table of all."""
    title = tag("h2", "Speed")
    if times is None or not times.frames:
        where = times_path(trace).name
        text = (
            f"No times of this run: replay and live write them to {where}, beside the trace, which holds none itself."
        )
        return [title, tag("p", text, class_="note")]
    step = [stage for stage in MAPPING if stage in times.stages]
    beside = [stage for stage in times.stages if stage not in step]
    shown = [k for k, value in enumerate(times.stages[step[0]]) if value is not None] if step else []
    frames = [times.frames[k] for k in shown]
    mapped = [(stage, [times.stages[stage][k] or 0.0 for k in shown]) for stage in step]
    others = [(WORDS.get(stage, stage), [value or 0.0 for value in times.stages[stage]]) for stage in beside]
    plots = (
        areas("Mapping", frames, mapped, "milliseconds of each frame, its stages on one another"),
        lines("Beside it", times.frames, others, "milliseconds; decode and trace have threads of their own")
        if others
        else None,
    )
    rows = [*mapped, (STEP, [sum(values) for values in zip(*(values for _, values in mapped), strict=True)])]
    table = [_row(name, frames, values) for name, values in rows if len(values)]
    table += [_row(name, times.frames, values) for name, values in others]
    heads = [tag("th", text, scope="col", data_kind="number" if k else None) for k, text in enumerate(COLUMNS)]
    figures = tag("table", tag("thead", tag("tr", heads)), tag("tbody", table), class_="plain figures")
    return [title, tag("div", plots, tag("div", figures, class_="scroll"), class_="plots")]


def _row(name: str, frames: Sequence[int], values: Sequence[float]) -> Html:
    longest = int(np.argmax(values))
    numbers = (float(np.median(values)), float(np.percentile(values, 95)), values[longest])
    cells = [tag("td", f"{value:.2f}", class_="number") for value in numbers]
    return tag("tr", tag("th", name, scope="row"), cells, tag("td", frames[longest], class_="number"))
