"""Results for people: tables on stdout. With --json the same result as one JSON object instead."""

from __future__ import annotations

import dataclasses
import json
import math
import shlex
import sys
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


def _print_table(columns: Sequence[str], rows: Iterable[Sequence[Any]], title: str = "") -> None:
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
        table.add_row(*(Text(_cell(value)) for value in row))
    console = Console(highlight=False)
    if console.is_terminal:
        console.print(table)
        return
    console.width = 140  # a file or a pipe has no edge to wrap at; 80 would cut captions
    with console.capture() as printed:
        console.print(table)
    print("\n".join(line.rstrip() for line in printed.get().splitlines()))


def _cell(value: Any) -> str:
    """One value as text; control characters, which a caption from a file could hold, are shown as `?`."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.3f}"
    if isinstance(value, (list, tuple)):
        return ", ".join(_cell(item) for item in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_cell(item)}" for key, item in value.items())
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
            _print_table(list(value[0]), [list(row.values()) for row in value], name)
        elif isinstance(value, Mapping) and len(_cell(value)) > INLINE:
            print(f"{indent}{name}")
            _print_pairs(value, indent + "  ")
        else:
            print(f"{indent}{name:<{width}}  {_cell(value) or '-'}")


def ingest(data: Data) -> None:
    """What was recorded, and what was left out and why."""
    near, far = data["depth_range_m"]
    print(
        f"{data['frames']} frames, numbers {data['first']} to {data['last']}, {data['seconds']:.1f} s, path "
        f"{data['path_length_m']:.2f} m, depth {near:.2f} to {far:.2f} m, "
        f"{'with' if data['has_truth'] else 'without'} ground truth"
    )
    for reason, count in data["dropped"].items():
        print(f"left out: {count} frames ({reason})")
    _notes(data)
    print(f"recording digest {data['digest']}")
    _wrote(data["output"], data["replaced"])


def perceive(data: Data) -> None:
    """What was found, and what was there already."""
    kinds = ", ".join(f"{count} {kind}s" for kind, count in data["kinds"].items())
    again = f", {data['reused']} of them from an earlier run" if data["reused"] else ""
    print(
        f"{data['frames']} frames looked at{again}, {data['masks']} masks ({kinds or 'none'}), "
        f"{data['seconds']:.1f} s, captions encoded by {data['encoder']}"
    )
    _notes(data)
    _wrote(data["output"])


def perceive_several(data: Data) -> None:
    """The same for each of several recordings, or why one failed."""
    for result in data["recordings"]:
        if "error" in result:
            print(f"openvox: {result['error']}", file=sys.stderr)
        else:
            perceive(result)


def _notes(data: Data) -> None:
    for note in data["notes"]:
        print(f"note: {_cell(note)}")


def _wrote(path: str, replaced: bool = False) -> None:
    print(f"wrote {path}{' (an older file of that name was replaced)' if replaced else ''}")


def replay(data: Data) -> None:
    """Speed, size, what decided, digests, files."""
    print(
        f"{data['frames']} frames in {data['seconds']:.2f} s ({data['frames_per_second']:.1f} a second), "
        f"preset {data['preset']}, engine {data['engine']}"
    )
    if data["looked"] < data["frames"]:
        print(f"perception looked at {data['looked']} of them; the others changed nothing")
    print(f"{data['voxels']} voxels, {data['instances']} instances")
    _print_table(
        ["ms", "mean", "median", "p95"],
        [[stage, *(figures[name] for name in ("mean", "median", "p95"))] for stage, figures in data["ms"].items()],
    )
    print("decisions  " + _cell(data["decisions"]))
    for name, digest in data["digests"].items():
        print(f"{name} digest {digest}")
    for path in data["outputs"].values():
        if path:
            _wrote(path, path in data["replaced"])


def query(data: Data) -> None:
    """The answers of each text, best first."""
    for asked in data["queries"]:
        if not asked["found"]:
            print(f"{asked['text']!r}: the map has no instances")
            continue
        _print_table(
            ["instance", "caption", "score", "center (m)", "voxels"],
            [
                [a["instance"], a["caption"], a["score"], [f"{x:.2f}" for x in a["center"]], a["voxels"]]
                for a in asked["answers"]
            ],
            repr(asked["text"]),
        )


def export(data: Data) -> None:
    """How much was written, and where."""
    print(f"{data['instances']} instances, {data['voxels']} voxels")
    _wrote(data["output"], data["replaced"])


MEASURES = ("ap", "ap50", "ap25", "f50", "miou", "spill", "missed_share", "wrong_share")
LABELLINGS = ("instances", "instances_in_voxel", "instances_authors_rule")


def evaluate(data: Data) -> None:
    """The scores, and by name the objects that were split, merged or missed."""
    _print_table(["labels", *MEASURES], [[name, *(data[name][m] for m in MEASURES)] for name in LABELLINGS])
    counts = data["instances"]
    print("  ".join(f"{name} {counts[name]}" for name in ("predicted", "true", "split", "merged", "missed")))
    troubled = [o for o in data["objects"] if o["missed"] or o["merged_with"] or len(o["split_into"]) > 1]
    if troubled:
        _print_table(
            ["id", "object", "best IoU", "split into", "merged with", "missed"],
            [[o["id"], o["name"], o["best_iou"], o["split_into"], o["merged_with"], o["missed"]] for o in troubled],
            "objects split, merged or missed",
        )
    for name in ("calibration", "rendered_masks", "semantics"):
        print(f"{name.replace('_', ' ')}  {_cell(data[name])}")
    for kind, found in (data["retrieval"] or {}).items():
        print(f"retrieval {kind}  {_cell(found)}")
    _notes(data)


DECISION = ("mask", "caption", "by", "instance", "voxels", "s_geo", "s_fea", "a", "visibility", "credibility")
LISTED = 4


def explain(data: Data) -> None:
    """The decisions of one frame, each with its best candidates, and what they led to."""
    if not data["looked"]:
        print(f"frame {data['frame']}: perception did not look at it, so nothing was decided")
        return
    print(f"frame {data['frame']}: {len(data['decisions'])} masks")
    if data["decisions"]:
        _print_table(
            ["mask", "caption", "rule", "instance", "voxels", "S_geo", "S_fea", "A", "R", "w", "candidates by A"],
            [[*(decision[name] for name in DECISION), _candidates(decision)] for decision in data["decisions"]],
            f"threshold of A: {data['decisions'][0]['threshold']:.3f}",
        )
    for event in data["events"]:
        print(f"instance {event['instance']} {event['kind']}: {_cell(event['text'])}")


def _candidates(decision: Data) -> str:
    """The best few, as instance and A."""
    texts = [f"{c['instance']}: {c['a']:.2f}" for c in decision["candidates"]]
    return "  ".join(texts[:LISTED]) + ("  ..." if len(texts) > LISTED else "")


def parameters(data: Data) -> None:
    """Every parameter with unit, range, default and reason, by the command whose --set takes it."""
    for command in dict.fromkeys(row["command"] for row in data["parameters"]):
        rows = [row for row in data["parameters"] if row["command"] == command]
        _print_table(
            ["parameter", "default", "unit", "range", "why"],
            [[row["name"], _setting(row["default"]), row["unit"], row["range"], row["why"]] for row in rows],
            f"openvox {command} --set",
        )


def _setting(value: Any) -> str:
    """As one would type it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
