"""The page of one map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from openvox.apps.reporting.crops import Crop
from openvox.apps.reporting.parts import (
    Column,
    head,
    notes,
    number,
    provenance,
    scenes,
    searched,
    swatch,
    with_contents,
)
from openvox.core.colors import category_colors, instance_color
from openvox.core.types import InstanceMap, InstanceSummary
from openvox.formats.images import encode_jpeg
from openvox.view.labels import shortened
from openvox.view.page.cubes import scene
from openvox.view.page.document import Html, data_uri, page, tag
from openvox.view.pictures import map_azimuth, map_picture

PICTURE = (960, 640)
QUALITY = 82
SIDES = (0.0, 2 * math.pi / 3, 4 * math.pi / 3)
"""Radians from the best side."""
STRAIGHT_DOWN = math.pi / 2
OTHER_CAPTIONS = 3
MODES = (("instance", "by instance"), ("category", "by category"), ("confidence", "by confidence"))
LEGEND = 40
"""Categories that the legend names, those of most instances."""
COLUMNS = (
    Column("Id", number=True),
    Column("Best views", sorts=False),
    Column("Caption"),
    Column("Confidence", number=True, down=True),
    Column("Seen", number=True, down=True),
    Column("Voxels", number=True, down=True),
    Column("Size (m)", number=True, down=True),
    Column("Frames", number=True),
)


def map_page(
    title: str,
    result: InstanceMap,
    digest: str,
    run: Sequence[Html],
    crops: Mapping[int, Sequence[Crop]],
    remarks: Sequence[str],
    categories: Sequence[str],
) -> str:
    """HTML. title: the map's name. run: what its trace tells. crops: by instance. remarks: what is missing, and why.
    categories: one an instance."""
    azimuth = map_azimuth(result)
    lead = "Instances that OpenVox found in a recording, and how sure it is of them."
    columns = COLUMNS if crops else tuple(c for c in COLUMNS if c.title != "Best views")
    rows = [
        _row(summary, float(confidence), crops.get(summary.id, ()), bool(crops), category)
        for summary, confidence, category in zip(result.instances, result.instance_confidence, categories, strict=True)
    ]
    hint = "Drag to turn; pinch, or + and \u2212, to zoom; two fingers, or shift, to move. Tap a thing to find its row."
    main = [
        notes(remarks),
        tag(
            "div",
            scenes([""], MODES, hint, _legend(categories)),
            searched("instances", "Instances", columns, rows, "instances"),
            class_="split",
        ),
        _pictures(result, azimuth),
        run,
        provenance(result, digest),
    ]
    content = [head(title, lead, _facts(result)), with_contents(main), foot(digest)]
    shown = scene_of(result)
    by_category = [list(color) for color in category_colors(categories)]
    shown["palettes"].append({"name": "category", "colors": by_category})
    return page(f"{title} \u2013 openvox", content, {"azimuth": azimuth, "maps": [shown]})


def foot(digest: str) -> Html:
    """The last line: which map this is."""
    return tag("footer", "Made by openvox. Everything on this page is in this one file. Map ", tag("code", digest[:16]))


def scene_of(result: InstanceMap) -> dict[str, Any]:
    """A map for the page's scripts, with a colour an instance, and the corners that the camera looks at, in metres."""
    shown = result.voxel_index[result.voxel_instance > 0] if (result.voxel_instance > 0).any() else result.voxel_index
    shown = shown if len(shown) else np.zeros((1, 3), np.int32)
    colors = [list(instance_color(i)) for i in result.instance_id.tolist()]
    palettes = [{"name": name, "colors": colors} for name in ("instance", "confidence")]
    low, high = shown.min(0), shown.max(0) + 1
    return {
        **scene(result),
        "palettes": palettes,
        "lowest": [float(x) * result.voxel_size for x in low],
        "highest": [float(x) * result.voxel_size for x in high],
    }


def _legend(categories: Sequence[str]) -> Html:
    """The colours of the categories of most instances, by name."""
    color = dict(zip(categories, category_colors(categories), strict=True))
    often = sorted(color, key=lambda name: (-categories.count(name), name))[:LEGEND]
    names = [tag("span", swatch(color[name]), " ", shortened(name, 40)) for name in sorted(often)]
    more = f"and {len(color) - len(often)} more" if len(color) > len(often) else None
    return tag("div", names, more, class_="legend category")


def _facts(result: InstanceMap) -> list[tuple[str, Any]]:
    confirmed = sum(summary.state == "confirmed" for summary in result.instances)
    return [
        ("instances", len(result.instances)),
        ("of them confirmed", confirmed),
        ("voxels", len(result.voxel_index)),
        ("edge of a voxel", f"{100 * result.voxel_size:g} cm"),
        ("frames", result.meta.get("frames")),
        ("preset", result.meta.get("preset")),
    ]


def _row(summary: InstanceSummary, confidence: float, views: Sequence[Crop], with_crops: bool, category: str) -> Html:
    sides = [high - low for low, high in zip(*summary.bounds, strict=True)]
    size = " \u00d7 ".join(f"{side:.2f}" for side in sides)
    volume = math.prod(sides)
    others = [text for text, _ in summary.captions if text != summary.caption][:OTHER_CAPTIONS]
    more = tag("span", "also: " + "; ".join(others), class_="also") if others else None
    kind = tag("span", f"category: {category}", class_="also")
    tentative = tag("span", "tentative", class_="also") if summary.state != "confirmed" else None
    name = f"{summary.id}: {shortened(summary.caption, 120) or 'no caption'}"
    button = tag("button", swatch(instance_color(summary.id)), summary.id, type="button", class_="id", title="Show it")
    caption = tag("span", summary.caption or "no caption", class_="caption")
    return tag(
        "tr",
        tag("td", button, data_value=summary.id),
        tag("td", _views(views), class_="views") if with_crops else None,
        tag("td", caption, more, kind, tentative, class_="wrap wide", data_value=summary.caption.lower()),
        _number(f"{confidence:.2f}", confidence, "confidence"),
        _number(number(summary.observations), summary.observations, "seen"),
        _number(number(summary.voxels), summary.voxels, "voxels"),
        _number(size, volume, "size"),
        _number(f"{summary.first_frame}\u2013{summary.last_frame}", summary.first_frame, "frames"),
        data_select=f"[[{summary.id}]]",
        data_name=name,
        data_text=" ".join([str(summary.id), category, *(text for text, _ in summary.captions)]).lower(),
        aria_selected="false",
        id=f"instance-{summary.id}",
    )


def _number(text: str, value: float, label: str) -> Html:
    return tag("td", text, class_="number", data_value=f"{value:.6g}", data_label=label)


def _views(views: Sequence[Crop]) -> Html | None:
    if not views:
        return None
    pictures = [
        tag(
            "img",
            src=data_uri("image/jpeg", view.jpeg),
            width=view.width,
            height=view.height,
            loading="lazy",
            alt=f"frame {view.frame}",
            title=f"frame {view.frame}",
        )
        for view in views
    ]
    return tag("div", pictures, class_="crops")


def _pictures(result: InstanceMap, azimuth: float) -> list[Html]:
    """Three sides, and from straight above."""
    width, height = PICTURE
    sides = [map_picture(result, azimuth + turn, width=width, height=height) for turn in SIDES]
    names = ["the side that shows most", "a third further round", "two thirds further round", "straight down"]
    down = map_picture(result, azimuth, width=width, height=height, elevation=STRAIGHT_DOWN)
    figures = [
        tag(
            "figure",
            tag(
                "img",
                src=data_uri("image/jpeg", encode_jpeg(picture, QUALITY)),
                width=width,
                height=height,
                loading="lazy",
                alt=f"The map from {name}" if name != names[-1] else "The map seen straight down",
            ),
            tag("figcaption", name[0].upper() + name[1:]),
        )
        for name, picture in zip(names, [*sides, down], strict=True)
    ]
    return [tag("h2", "From four sides"), tag("div", figures, class_="pictures")]
