"""One item of a sweep, from files to files: mapped and scored, or found done. Needs nothing but its Item."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from openvox.apps.replay import replay
from openvox.apps.scoring.instances import score_instances
from openvox.apps.scoring.labels import labels_of_rows, rows_at_points
from openvox.apps.scoring.recording_truth import recording_truth
from openvox.apps.sweeping.plan import Item
from openvox.apps.sweeping.shared import shared_frames
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.formats.atomic import partial_file
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.map_npz import read_map
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.trace import trace_info
from openvox.formats.truth import Truth, read_truth

MAPPED = ("seconds", "frames", "voxels", "instances", "decisions")


def run_item(item: Item) -> dict[str, Any]:
    """`key`, `reused`, `seconds`, `frames`, `voxels`, `instances`, `decisions`, `digests`, `scores`, `truth`.

    What an earlier run left under the item's names is taken if it is whole and of the same inputs and parameters.
    Raises InputError, OutputError."""
    record = Path(f"{item.stem}.json")
    found = _earlier(item, record)
    mapped = found or _mapped(item)
    truth = item.source.digests.get("truth")
    if found is None or found.get("truth") != truth:
        scores = None if item.source.truth is None else _scores(item, item.source.truth)
        mapped = {**mapped, "scores": scores, "truth": truth}
        with partial_file(record) as partial:
            partial.write_text(json.dumps(mapped, sort_keys=True, allow_nan=False), encoding="utf-8")
    return {**mapped, "reused": found is not None}


def _mapped(item: Item) -> dict[str, Any]:
    run = item.run
    made = replay(
        item.source.path,
        perception=item.source.perception,
        preset_name=run.preset,
        params=run.params,
        assignments=item.set.assignments,
        engine=run.engine,
        out=str(item.stem),
        start=run.start,
        end=run.end,
        stride=run.stride,
        read=shared_frames,
    )
    digests = {**made["digests"], "perception": item.source.digests["perception"]}
    return {"key": item.key, "digests": digests, **{name: made[name] for name in MAPPED}}


def _earlier(item: Item, record: Path) -> dict[str, Any] | None:
    """What an earlier run noted of the item, if its map and trace are still what it says."""
    try:
        noted = json.loads(record.read_text(encoding="utf-8"))
        digests = noted["digests"]
        whole = (
            noted["key"] == item.key
            and {*MAPPED, "scores"} <= set(noted)
            and trace_info(Path(f"{item.stem}{TRACE_SUFFIX}")).digest == digests["trace"]
            and map_digest(read_map(Path(f"{item.stem}{MAP_SUFFIX}"))) == digests["map"]
        )
    except (OSError, ValueError, KeyError, TypeError, InputError):
        return None
    return noted if whole else None


def _scores(item: Item, truth: Path) -> Mapping[str, Any]:
    """The `instances` figures of `openvox evaluate`."""
    known, result = _truth(truth), read_map(Path(f"{item.stem}{MAP_SUFFIX}"))
    labels = labels_of_rows(rows_at_points(known.points, result), result)
    confidence = dict(zip(result.instance_id.tolist(), result.instance_confidence.tolist(), strict=True))
    scores = asdict(score_instances(known.instance, labels, confidence))
    return {name: value for name, value in scores.items() if name != "objects"}


@lru_cache(maxsize=2)
def _truth(truth: Path) -> Truth:
    return read_truth(truth, None) if truth.is_dir() else recording_truth(truth, None)
