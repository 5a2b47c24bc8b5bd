"""The page of a sweep: which parameter matters, which set is best, and every set in a table."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from openvox.apps.reporting.parts import Column, head, notes, number, pairs, searched, with_contents
from openvox.core.errors import InputError
from openvox.view.page.document import Html, page, tag
from openvox.view.page.plots import dots

FILE = "sweep.json"
FORMAT_VERSION = 1
LARGEST = 1 << 28
"""Bytes; a larger file is no sweep of ours."""
SCORES = ("ap", "ap50", "f50", "miou")


def read_sweep(folder: Path) -> dict[str, Any]:
    """What a sweep left in its folder. Raises InputError."""
    path = folder / FILE
    try:
        if path.stat().st_size > LARGEST:
            raise InputError(f"{path} has {path.stat().st_size} bytes; expected what `openvox sweep` wrote")
        found = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{folder} holds no {FILE} to read ({error.strerror}); name a sweep's folder") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is no JSON ({error}); run the sweep again") from None
    version = found.get("format_version") if isinstance(found, dict) else None
    if not isinstance(version, int) or version < 1:
        raise InputError(f"{path} has no format version; expected what `openvox sweep` wrote")
    if version > FORMAT_VERSION:
        raise InputError(f"{path} has format {version}, this openvox reads up to {FORMAT_VERSION}: use a newer openvox")
    return dict(found)


def sweep_page(title: str, sweep: Mapping[str, Any]) -> str:
    """HTML. sweep: as read_sweep gives it. Raises InputError where it is not as a sweep writes it."""
    try:
        items, sets = sweep["items"], sweep["sets"]
        main = [
            notes(sweep.get("notes", ())),
            _best(sweep),
            _effects(sweep["effects"], sweep["measure"]),
            _sets(_by_rank(sets, sweep["measure"], sweep["best"]), sweep["varied"]),
            _items(items, sweep["varied"]),
            _failures(items),
            _inputs(sweep),
        ]
        facts = [
            ("sets", len(sets)),
            ("recordings", len(sweep["recordings"])),
            ("runs", len(items)),
            ("failed", int(sweep["failed"])),
            ("preset", str(sweep["preset"])),
        ]
        lead = f"Every combination of {', '.join(sweep['varied']) or 'no parameter'}, on every recording."
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise InputError(f"{title}: {FILE} is not as a sweep writes it ({error!r}); run the sweep again") from None
    foot = tag("footer", "Made by openvox. Everything on this page is in this one file.")
    return page(f"{title} \u2013 openvox", [head(title, lead, facts), with_contents(main), foot], {"maps": []})


def _words(parameters: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {number(value)}" for name, value in parameters.items()) or "the preset's values"


def _best(sweep: Mapping[str, Any]) -> list[Html]:
    best = sweep["best"]
    if best is None:
        return notes(["Without ground truth no set can be called the best; the plots show what changed."])
    gain = best["score"] - best["default_score"] if best["default_score"] is not None else None
    beside = "" if gain is None else f", {gain:+.4f} against the default's {best['default_score']:.4f}"
    text = f"{sweep['measure']} {best['score']:.4f}{beside}"
    ties = best.get("ties", ())
    told = f"{len(ties)} more, less than 0.001 behind, as good: set {', '.join(map(str, ties))}." if ties else ""
    return [
        tag("h2", "The best set"),
        pairs([(_words(best["parameters"]), text, False)]),
        *notes([told] if told else []),
    ]


def _effects(effects: Sequence[Mapping[str, Any]], measure: str | None) -> list[Html]:
    """A plot a parameter: the mean of a measure at each of its values, what matters most first."""
    shown = [effect for effect in effects if effect["measure"] in (measure, "instances")]
    shown.sort(key=lambda effect: effect["measure"] != measure)
    plots = []
    for effect in shown:
        rows = [(number(mean["value"]), float(mean["mean"])) for mean in effect["means"] if mean["mean"] is not None]
        title = f"{effect['parameter']}: {effect['measure']}"
        note = (
            f"mean at each value, from least to most ({float(effect['range']):.4g}), not from zero"
            if effect["range"]
            else "mean at each value: no difference"
        )
        plots.append(dots(title, rows, note, digits=4 if effect["measure"] == measure else 1))
    return [tag("h2", "Which parameter matters"), tag("div", plots, class_="plots") if plots else _nothing()]


def _nothing() -> Html:
    return tag("p", "Only one value of each was tried; the sets below tell it from the default.", class_="note")


def _by_rank(
    sets: Sequence[Mapping[str, Any]], measure: str | None, best: Mapping[str, Any] | None
) -> list[Mapping[str, Any]]:
    """The best first; those without a score last."""
    first = best and best["set"]

    def place(one: Mapping[str, Any]) -> tuple[float, bool]:
        score = (one["scores"] or {}).get(measure)
        return (1.0 if score is None else -float(score), one["set"] != first)

    return sorted(sets, key=place)


def _sets(sets: Sequence[Mapping[str, Any]], varied: Mapping[str, Any]) -> Html:
    scores = [name for name in SCORES if any((one["scores"] or {}).get(name) is not None for one in sets)]
    columns = [Column("Set", number=True), *(Column(name) for name in varied)]
    columns += [Column(name, number=True, down=True) for name in (*scores, "instances", "voxels", "seconds")]
    columns.append(Column("failed", number=True, down=True))
    rows = [
        tag(
            "tr",
            tag("td", one["set"], " default" if one["default"] else None, class_="number", data_value=one["set"]),
            [_value(one["parameters"][name]) for name in varied],
            [_cell((one["scores"] or {}).get(name)) for name in scores],
            [_cell(one[name]) for name in ("instances", "voxels", "seconds", "failed")],
        )
        for one in sets
    ]
    return searched("sets", "Sets", columns, rows, "sets")


def _items(items: Sequence[Mapping[str, Any]], varied: Mapping[str, Any]) -> Html:
    columns = [Column("Recording"), Column("Set", number=True), *(Column(name) for name in varied)]
    columns += [Column("Map digest"), Column("First mask that went another way than with the default")]
    rows = [
        tag(
            "tr",
            tag("td", item["recording"]),
            tag("td", item["set"], class_="number"),
            [_value(item["parameters"][name]) for name in varied],
            tag("td", tag("code", str((item["digests"] or {}).get("map") or "\u2013")[:12])),
            tag("td", _outcome(item), class_="wrap"),
        )
        for item in items
    ]
    return searched("runs", "Runs", columns, rows, "runs")


def _outcome(item: Mapping[str, Any]) -> str:
    at = item["first_outcome"]
    if item["status"] != "done":
        return "failed"
    if at is None:
        return "the default" if item["default"] else "none"
    return f"frame {at['frame']}, mask {at['mask']} ({at['caption']}): {at['field']} {at['b']}, by default {at['a']}"


def _value(value: Any) -> Html:
    kind = float(value) if isinstance(value, (int, float)) else 0
    return tag("td", number(value), data_value=f"{kind:015.6f}" if kind else str(value))


def _cell(value: float | None) -> Html:
    text = (
        number(value)
        if not isinstance(value, float)
        else f"{value:.4f}"
        if value < 10
        else f"{value:.1f}"
        if value < 1000
        else number(round(value))
    )
    return tag("td", text, class_="number", data_value=-1 if value is None else f"{value:.9g}")


def _failures(items: Sequence[Mapping[str, Any]]) -> list[Html]:
    failed = [(f"{i['recording']}, set {i['set']}", str(i["error"]), True) for i in items if i["status"] != "done"]
    return [tag("h2", "What failed"), pairs(failed)] if failed else []


def _inputs(sweep: Mapping[str, Any]) -> list[Html]:
    rows = [
        (f"{one['name']} {name}", str(digest), False)
        for one in sweep["recordings"]
        for name, digest in sorted((one["digests"] or {}).items())
    ]
    fixed = [("fixed", ", ".join(sweep["fixed"]) or "nothing", False), ("engine", str(sweep.get("engine")), False)]
    return [tag("h2", "Where it comes from"), pairs([*fixed, *rows])]
