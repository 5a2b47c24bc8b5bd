"""The page of two maps: side by side, turned together, and what became of each instance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from openvox.apps.reporting.one_map import scene_of
from openvox.apps.reporting.parts import (
    Color,
    Column,
    head,
    notes,
    number,
    pairs,
    scenes,
    searched,
    swatch,
    with_contents,
)
from openvox.core.types import InstanceMap
from openvox.view.labels import shortened
from openvox.view.page.document import Html, page, tag

COLORS: Mapping[str, Color] = {
    "same": (150, 152, 158),
    "renamed": (128, 168, 220),
    "split": (232, 130, 40),
    "merged": (140, 80, 200),
    "vanished": (205, 50, 50),
    "appeared": (50, 160, 80),
}
"""What became of an instance, in words and on the map."""
COLUMNS = (
    Column("What"),
    Column("In A"),
    Column("In B"),
    Column("Overlap", number=True),
    Column("Voxels A", number=True, down=True),
    Column("Voxels B", number=True, down=True),
)
Entry = tuple[str, list[dict[str, Any]], list[dict[str, Any]], float | None]
"""What became of instances of A and of B (objects with instance, caption, voxels), and their overlap if matched."""


def maps_page(names: tuple[str, str], maps: tuple[InstanceMap, InstanceMap], found: Mapping[str, Any]) -> str:
    """HTML. names: of the maps. found: what `compare` says of them."""
    entries = _entries(found)
    in_a = {one["instance"]: kind for kind, side, _, _ in entries for one in side}
    in_b = {one["instance"]: kind for kind, _, side, _ in entries for one in side}
    scene = [_scene(maps[0], in_a), _scene(maps[1], in_b)]
    modes = [("difference", "by difference"), ("instance", "by instance"), ("confidence", "by confidence")]
    hint = "Both maps turn together. Tap a thing to find its row; press a row to see it in both."
    title = f"{names[0]} and {names[1]}"
    lead = "The maps are the same." if found["same"] else "Two maps of one place: what became of each instance."
    main = [
        scenes([f"A: {names[0]}", f"B: {names[1]}"], modes, hint, _legend()),
        searched("instances", "Instances", COLUMNS, [_row(entry) for entry in entries], "instances", cards=True),
        _where(found),
        _parameters(found),
    ]
    content = [head(title, lead, _facts(found, entries)), with_contents([notes(found["notes"]), main]), _foot(found)]
    return page(f"{title} \u2013 openvox", content, {"azimuth": 0.9, "maps": scene})


def _entries(found: Mapping[str, Any]) -> list[Entry]:
    """One an instance or group, what differs first. An instance stands in one entry of each map."""
    entries: list[Entry] = []
    grouped: tuple[set[int], set[int]] = (set(), set())
    for row in found["split_into"]:
        entries.append(("split", [row["a"]], row["b"], None))
    for row in found["merged_into"]:
        entries.append(("merged", row["a"], [row["b"]], None))
    entries += [("vanished", [one], [], None) for one in found["vanished"]]
    entries += [("appeared", [], [one], None) for one in found["appeared"]]
    for entry in entries:
        grouped[0].update(one["instance"] for one in entry[1])
        grouped[1].update(one["instance"] for one in entry[2])
    renamed = set(found["instances"]["renamed"])
    matched: list[Entry] = []
    for match in found["matches"]:
        if match["a"] in grouped[0] and match["b"] in grouped[1]:
            continue
        a, b = (
            [{"instance": match[k], "caption": match[f"{k}_caption"], "voxels": match[f"{k}_voxels"]}]
            for k in ("a", "b")
        )
        matched.append(("renamed" if match["a"] in renamed else "same", a, b, match["iou"]))
    return entries + sorted(matched, key=lambda entry: (entry[0] == "same", entry[3] or 0.0))


def _scene(one: InstanceMap, kind_of: Mapping[int, str]) -> dict[str, Any]:
    scene = scene_of(one)
    colors = [list(COLORS[kind_of.get(i, "same")]) for i in one.instance_id.tolist()]
    return {**scene, "palettes": [{"name": "difference", "colors": colors}, *scene["palettes"]]}


def _legend() -> Html:
    return tag(
        "div",
        [tag("span", swatch(color), " ", kind) for kind, color in COLORS.items()],
        class_="legend difference",
    )


def _facts(found: Mapping[str, Any], entries: Sequence[Entry]) -> list[tuple[str, Any]]:
    count = {kind: sum(entry[0] == kind for entry in entries) for kind in COLORS}
    share = found["agreement"]
    return [("agree", None if share is None else f"{100 * share:.1f} %"), *count.items()]


def _row(entry: Entry) -> Html:
    kind, a, b, iou = entry
    sums = [sum(one["voxels"] for one in side) for side in (a, b)]
    name = " / ".join(shortened("; ".join(f"{i['instance']}: {i['caption']}" for i in side), 90) for side in (a, b))
    button = tag("button", swatch(COLORS[kind]), kind, type="button", class_="id", title="Show it")
    ids = [[one["instance"] for one in side] for side in (a, b)]
    return tag(
        "tr",
        tag("td", button, data_value=kind),
        _side(a, "A"),
        _side(b, "B"),
        tag("td", "" if iou is None else f"{iou:.2f}", class_="number", data_value=iou or 0, data_label="overlap"),
        *(
            tag("td", number(n) if n else "", class_="number", data_value=n, data_label=f"voxels {k}")
            for k, n in zip("AB", sums, strict=True)
        ),
        data_select=str(ids),
        data_name=name,
        aria_selected="false",
    )


def _side(side: Sequence[Mapping[str, Any]], name: str) -> Html:
    lines = [tag("div", tag("b", one["instance"]), " ", one["caption"] or "no caption") for one in side]
    value = side[0]["caption"].lower() if side else ""
    return tag("td", lines, class_="wrap", data_value=value, data_label=f"in {name}")


def _where(found: Mapping[str, Any]) -> list[Html | None]:
    """The first decisions that differ, if the traces are there."""
    rows = [
        (
            words,
            f"frame {at['frame']}, mask {at['mask']} ({at['caption']}): {at['field']} {at['a']} in A, {at['b']} in B",
        )
        for words, at in (("first that differs", found["first_decision"]), ("first outcome", found["first_outcome"]))
        if at
    ]
    if not rows:
        return [None]
    return [tag("h2", "Where they part"), pairs((words, text, False) for words, text in rows)]


def _parameters(found: Mapping[str, Any]) -> list[Html]:
    differ = {**found["parameters"], **found["inputs"]}
    rows = [(name, f"{number(both['a'])} in A, {number(both['b'])} in B", False) for name, both in differ.items()]
    return [
        tag("h2", "Parameters and inputs that differ"),
        pairs(rows) if rows else tag("p", "None.", class_="note"),
    ]


def _foot(found: Mapping[str, Any]) -> Html:
    digests = [tag("code", found[k]["map_digest"][:16]) for k in ("a", "b")]
    return tag(
        "footer", "Made by openvox. Everything on this page is in this one file. Maps ", digests[0], " and ", digests[1]
    )
