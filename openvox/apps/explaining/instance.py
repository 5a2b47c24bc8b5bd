"""The life of one instance: its masks, fragments, captions, growth, and what happened to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from typing import Any

import numpy as np

from openvox.apps.explaining.run import Longs, Run
from openvox.core.errors import InputError
from openvox.core.fixedpoint import Q20

NEIGHBOURS = 5


def explain_instance(run: Run, instance: int) -> dict[str, Any]:
    """All that the trace knows of an instance, also of one that was merged away. Raises InputError."""
    masks = [_mask(run, position, row) for position, row in run.decisions() if _belongs(run, row, instance)]
    events = events_of(run, {instance})
    if not masks and not events and instance not in run.final.values():
        known = sorted(set(run.final.values()) - run.dropped.keys())
        raise InputError(f"{run.path}: there was never an instance {instance}; in the end there are {_few(known)}")
    fragments = sorted(f for f, i in run.final.items() if i == instance)
    votes = voxels_of(run, fragments)
    captions = Counter(one["caption"] for one in masks)
    return {
        "instance": instance,
        "state": _state(run, instance, events),
        "first_frame": masks[0]["frame"] if masks else None,
        "last_frame": masks[-1]["frame"] if masks else None,
        "masks": masks,
        "captions": [
            {"caption": caption, "masks": count}
            for caption, count in sorted(captions.items(), key=lambda item: (-item[1], item[0]))
        ],
        "fragments": [_fragment(run, f) for f in fragments],
        "growth": _growth(run, fragments),
        "voxels": int((run.final_owner[votes] == instance).sum()),
        "sharing": _sharing(run, instance, votes),
        "events": events,
    }


def _belongs(run: Run, row: Any, instance: int) -> bool:
    return bool(row["instance"] == instance or run.final[row["fragment"]] == instance)


def _few(ids: list[int]) -> str:
    return ", ".join(map(str, ids[:20])) + (" ..." if len(ids) > 20 else "") if ids else "none"


def _mask(run: Run, position: int, row: Any) -> dict[str, Any]:
    return {
        "frame": run.frames[position].frame,
        "mask": row["mask"],
        "caption": row["caption"],
        "by": row["by"],
        "a": row["a"] / Q20,
        "voxels": row["voxels"],
        "fragment": row["fragment"],
        "instance_then": row["instance"],
        "instance_in_the_end": run.final[row["fragment"]],
    }


def _state(run: Run, instance: int, events: list[dict[str, Any]]) -> str:
    """In words: confirmed, tentative, dropped, part of another instance, or there before a run that was resumed."""
    if instance in run.dropped:
        return f"dropped: {run.dropped[instance]}"
    if instance not in run.final.values():
        into = run.final.get(instance)
        return f"part of instance {into}" if into else "never founded"
    confirmed = [event["frame"] for event in events if event["kind"] == "confirmed" and event["instance"] == instance]
    if confirmed:
        return f"confirmed in frame {confirmed[0]}"
    return "tentative" if any(event["kind"] in ("new", "split") for event in events) else "of the run before this one"


def captions_of(run: Run, instance: int, end: int) -> Counter[str]:
    """Captions of the masks that joined an instance before position `end`, fragments as they were grouped then."""
    before = run.instances_before(end)
    out: Counter[str] = Counter()
    for found in run.frames[:end]:
        for row in found.decisions:
            if row["fragment"] and before.get(row["fragment"]) == instance:
                out[row["caption"]] += 1
    return out


def events_of(run: Run, instances: Collection[int]) -> list[dict[str, Any]]:
    """Events that name one of the instances, in order."""
    return [
        {
            "frame": found.frame,
            "kind": event.kind,
            "instance": event.instance,
            "others": list(event.others),
            "text": event.text,
        }
        for found in run.frames
        for event in found.events
        if event.instance in instances or (event.kind != "cut" and set(event.others) & set(instances))
    ]


def voxels_of(run: Run, fragments: list[int]) -> Longs:
    """Voxels that hold votes for any of the fragments in the end, ascending."""
    voxel, fragment, _ = run.final_votes
    return np.unique(voxel[np.isin(fragment, fragments)])


def _fragment(run: Run, fragment: int) -> dict[str, Any]:
    masks = [row for _, row in run.decisions() if row["fragment"] == fragment]
    captions = Counter(row["caption"] for row in masks)
    return {
        "fragment": fragment,
        "masks": len(masks),
        "voxels_with_votes": len(voxels_of(run, [fragment])),
        "caption": min(captions, key=lambda caption: (-captions[caption], caption), default=""),
    }


def _growth(run: Run, fragments: list[int]) -> list[dict[str, int]]:
    """Voxels that ever got a vote for one of the fragments, after each frame in which their number grew."""
    rows = np.flatnonzero(np.isin(run.fragment, fragments))
    _, first = np.unique(run.voxel[rows], return_index=True)
    added = np.bincount(run.position[rows[first]], minlength=len(run.frames))
    total = np.cumsum(added)
    return [
        {"frame": run.frames[position].frame, "voxels": int(total[position])}
        for position in np.flatnonzero(added).tolist()
    ]


def _sharing(run: Run, instance: int, voxels: Longs) -> list[dict[str, Any]]:
    """Other instances with votes in the same voxels, most shared first."""
    voxel, owner, _, _ = run.shares(len(run.frames), run.final)
    others = owner[np.isin(voxel, voxels) & (owner != instance) & (owner > 0)]
    ids, shared = np.unique(others, return_counts=True)
    order = np.lexsort((ids, -shared))[:NEIGHBOURS]
    return [
        {"instance": int(ids[i]), "voxels": int(shared[i]), "share": int(shared[i]) / max(1, len(voxels))}
        for i in order.tolist()
    ]
