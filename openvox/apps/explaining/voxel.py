"""The history of one voxel: which masks voted, when its owner changed, and what it holds now."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from openvox.apps.explaining.run import Run
from openvox.core.errors import InputError

FAR = 42_000.0
"""Metres from the origin beyond which no voxel lies."""


def explain_voxel(run: Run, at: Sequence[float]) -> dict[str, Any]:
    """Every frame that changed the voxel at a point, metres. Raises InputError where none holds votes."""
    number = _voxel_at(run, at)
    counts: dict[int, int] = {}
    instance_of: dict[int, int] = {}
    history = []
    owner = 0
    rows = np.flatnonzero(run.voxel == number)
    touched: dict[int, list[int]] = {}
    for row in rows.tolist():
        touched.setdefault(int(run.position[row]), []).append(row)
    for position, found in enumerate(run.frames):
        instance_of.update(found.regrouped)
        changed = touched.get(position, [])
        for row in changed:
            counts[int(run.fragment[row])] = int(run.count[row])
        now = owner_of(counts, instance_of)
        if changed or now != owner:
            history.append(
                {
                    "frame": found.frame,
                    "votes": [_vote(run, position, row, instance_of) for row in changed],
                    "owner_before": owner,
                    "owner": now,
                }
            )
        owner = now
    return {
        "at": list(at),
        "voxel": run.index[number].tolist(),
        "center": run.center(number),
        "history": history,
        "now": {"owner": owner, "dropped": run.dropped.get(owner), "votes": _now(run, counts)},
    }


def owner_of(counts: Mapping[int, int], instance_of: Mapping[int, int]) -> int:
    """The instance with most votes if it beats background, the lowest id on a tie; 0 = background."""
    votes: dict[int, int] = {}
    for fragment, count in counts.items():
        if fragment >= 0:
            instance = instance_of.get(fragment, 0)
            votes[instance] = votes.get(instance, 0) + count
    best = min((i for i in votes if i), key=lambda i: (-votes[i], i), default=0)
    return best if best and votes[best] > votes.get(0, 0) else 0


def _voxel_at(run: Run, at: Sequence[float]) -> int:
    if not all(math.isfinite(value) and abs(value) < FAR for value in at):
        raise InputError(f"{run.path}: no voxel can lie at {_point(at)}; expected metres in the map's world")
    index = np.array([math.floor(value / run.voxel_size) for value in at])
    found = np.flatnonzero((run.index == index).all(1))
    if len(found):
        return int(found[0])
    if not len(run.index):
        raise InputError(f"{run.path}: no voxel ever got a vote")
    nearest = int(((run.index - index) ** 2).sum(1).argmin())
    center = run.center(nearest)
    away = math.dist(center, at)
    raise InputError(
        f"{run.path}: no voxel at {_point(at)} ever got a vote; the nearest lies {away:.2f} m away at {_point(center)}"
    )


def _point(at: Sequence[float]) -> str:
    return ",".join(f"{value:g}" for value in at)


def _vote(run: Run, position: int, row: int, instance_of: Mapping[int, int]) -> dict[str, Any]:
    """A changed count, and the masks of the frame that hold its fragment, if it grew."""
    fragment, count, before = int(run.fragment[row]), int(run.count[row]), int(run.before[row])
    masks = [d for d in run.frames[position].decisions if count > before and fragment in d["held"]]
    return {
        "fragment": fragment,
        "instance": instance_of.get(fragment, 0),
        "votes_before": before * run.vote_unit,
        "votes": count * run.vote_unit,
        "masks": [d["mask"] for d in masks],
        "captions": [d["caption"] for d in masks],
    }


def _now(run: Run, counts: Mapping[int, int]) -> list[dict[str, Any]]:
    """What the voxel holds after the last frame, most votes first."""
    total = max(1, sum(counts.values()))
    return [
        {
            "fragment": fragment,
            "instance": run.final.get(fragment, 0),
            "votes": count * run.vote_unit,
            "share": count / total,
        }
        for fragment, count in sorted(counts.items(), key=lambda item: (-item[1], item[0]))
        if count
    ]
