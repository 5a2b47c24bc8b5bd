"""Why one mask went where it went: scores, margins, votes, evidence, and what its instance was before and became."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from openvox.apps.explaining.instance import captions_of, events_of
from openvox.apps.explaining.run import Longs, Row, Run
from openvox.apps.explaining.suspicious import likeness, signs, words_in
from openvox.core.errors import InputError
from openvox.core.fixedpoint import Q20

CONTRIBUTIONS = 10
RIVALS = 3
"""Candidates beside the chosen one whose evidence is told."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One decision, and the map before it where it voted."""

    run: Run
    position: int
    row: Row
    before: Mapping[int, int]
    """Instance of every fragment before the frame."""
    voxels: Longs
    """Those that gained votes by it."""
    shares: tuple[Longs, Longs, Longs, Longs]
    """Votes by instance before the frame; see Run.shares."""

    @property
    def chosen(self) -> int:
        """The instance that the mask joined, as it was before the frame; 0 if it founded one or was cut off."""
        row = self.row
        return self.before.get(row["fragment"], 0) if row["by"] in ("containment", "threshold") else 0

    @property
    def rivals(self) -> list[int]:
        """The other candidates, best A first."""
        return [c["instance"] for c in self.row["candidates"] if c["instance"] != self.chosen][:RIVALS]


def explain_mask(run: Run, frame: int, mask: int) -> dict[str, Any]:
    """One decision in words and numbers: scores in [0, 1], coordinates in metres. Raises InputError."""
    position = run.position_of(frame)
    rows = [row for row in run.frames[position].decisions if row["mask"] == mask]
    if not rows:
        raise InputError(
            f"{run.path}: frame {frame} has {len(run.frames[position].decisions)} masks, numbered from 0, and no {mask}"
        )
    row = rows[0]
    before = run.instances_before(position)
    shares = run.shares(position, before)
    scene = Scene(run, position, row, before, run.cast(position, row["held"]), shares)
    final = run.final.get(row["fragment"], 0)
    return {
        "frame": frame,
        "mask": mask,
        "caption": row["caption"],
        "kind": row["kind"],
        "by": row["by"],
        "instance": row["instance"],
        "instance_in_the_end": final,
        "fragment": row["fragment"],
        "held": row["held"],
        "voxels": row["voxels"],
        "voted": len(scene.voxels),
        "abstained": row["abstained"],
        "verdict": verdict(scene),
        "signs": signs(row, before),
        "candidates": [_candidate(scene, candidate) for candidate in row["candidates"]],
        "scores": {
            **{name: row[name] / Q20 for name in ("s_geo", "s_fea", "a", "threshold", "visibility")},
            "credibility": row["credibility"] / 4096,
            "weight_geometry": run.parameters["association.weight_geometry"],
            "weight_feature": run.parameters["association.weight_feature"],
        },
        "margin": _margin(scene),
        "contributions": [_contributions(scene, i) for i in [scene.chosen, *scene.rivals[:1]] if i],
        "evidence": [evidence(scene, i) for i in [scene.chosen, *scene.rivals] if i],
        "background": _background(scene),
        "history": _history(scene, final),
    }


def verdict(scene: Scene) -> str:
    """Which rule decided, and what A and the threshold alone would have done, in a sentence."""
    row = scene.row
    best = row["candidates"][0] if row["candidates"] else None
    alone = "it would found a new instance"
    if best and best["a"] > row["threshold"]:
        alone = f"it would join instance {best['instance']}"
    by_a = f"by A and the threshold alone {alone}"
    texts = {
        "containment": f"it joins instance {scene.chosen} by containment: it holds {_fragments(row['held'])}, "
        f"most of it {row['fragment']}; {by_a}",
        "threshold": f"it holds nothing, and joins instance {scene.chosen}, whose A exceeds the threshold",
        "new": f"it founds instance {row['fragment']}: it holds nothing that the map knows; {by_a}",
        "cut": f"it takes fragment {row['fragment']}, cut off one that another mask of the frame keeps; {by_a}",
        "small": "it is skipped: too few pixels",
        "empty": "it is skipped: none of its pixels has a depth within reach",
    }
    return texts.get(row["by"], f"rule {row['by']}")


def _fragments(held: list[int]) -> str:
    return f"fragment{'s' if len(held) > 1 else ''} {', '.join(map(str, held))}"


def _candidate(scene: Scene, candidate: Row) -> dict[str, Any]:
    weights = (scene.run.parameters["association.weight_geometry"], scene.run.parameters["association.weight_feature"])
    geometry, feature = candidate["s_geo"] / Q20, candidate["s_fea"] / Q20
    return {
        "instance": candidate["instance"],
        "chosen": candidate["instance"] == scene.chosen,
        "overlap": candidate["overlap"],
        "s_geo": geometry,
        "s_fea": feature,
        "a": candidate["a"] / Q20,
        "from_geometry": weights[0] * geometry,
        "from_feature": weights[1] * feature,
        "caption": usual(captions_of(scene.run, candidate["instance"], scene.position)),
    }


def usual(captions: Mapping[str, int]) -> str:
    """The caption of most masks, the first in the alphabet among equals."""
    return min(captions, key=lambda caption: (-captions[caption], caption), default="")


def _margin(scene: Scene) -> dict[str, Any]:
    """Best A minus threshold, best minus second, and the chosen one's A minus the best other's; None without them."""
    a = [candidate["a"] for candidate in scene.row["candidates"]]
    chosen = [c["a"] for c in scene.row["candidates"] if c["instance"] == scene.chosen]
    others = [c["a"] for c in scene.row["candidates"] if c["instance"] != scene.chosen]
    return {
        "best_minus_threshold": (a[0] - scene.row["threshold"]) / Q20 if a else None,
        "best_minus_second": (a[0] - a[1]) / Q20 if len(a) > 1 else None,
        "chosen_minus_rival": (chosen[0] - others[0]) / Q20 if chosen and others else None,
    }


def _contributions(scene: Scene, instance: int) -> dict[str, Any]:
    """The mask's voxels with the largest share of votes for a candidate before the frame; most votes first in ties."""
    voxel, owner, count, total = scene.shares
    mine = (owner == instance) & np.isin(voxel, scene.voxels)
    voxel, count = voxel[mine], count[mine]
    share = (count << 20) // np.maximum(total[voxel], 1)
    order = np.lexsort((voxel, -count, -share))[:CONTRIBUTIONS]
    unit = scene.run.vote_unit
    return {
        "instance": instance,
        "voxels_with_votes": len(voxel),
        "largest": [
            {
                "center": scene.run.center(int(voxel[i])),
                "votes": int(count[i]) * unit,
                "of": int(total[voxel[i]]) * unit,
                "share": int(share[i]) / Q20,
                "of_s_geo": int(share[i]) / Q20 / scene.row["voxels"],
            }
            for i in order.tolist()
        ],
    }


def evidence(scene: Scene, instance: int) -> dict[str, Any]:
    """What spoke for and against an instance before the frame: seen together and apart, captions, votes."""
    group = {f for f, i in scene.before.items() if i == instance}
    others = set(scene.row["held"]) - group
    together, apart = seen(scene.run, group, others, scene.position)
    captions = captions_of(scene.run, instance, scene.position)
    alike = likeness(scene.row["caption"], words_in(captions), captions.total())
    return {
        "instance": instance,
        "chosen": instance == scene.chosen,
        "held_fragments": sorted(group & set(scene.row["held"])),
        "frames_together": together,
        "frames_apart": apart,
        "masks_before": captions.total(),
        "caption": usual(captions),
        "caption_likeness": alike if captions else None,
        "voxels_owned_under_mask": next(
            (c["overlap"] for c in scene.row["candidates"] if c["instance"] == instance), 0
        ),
    }


def seen(run: Run, group: set[int], others: set[int], end: int) -> tuple[int, int]:
    """Frames before position `end` in which a fragment of each side lay in one mask; in which they lay in two only."""
    together = apart = 0
    for found in run.frames[:end]:
        held = [set(row["held"]) for row in found.decisions]
        if any(one & group and one & others for one in held):
            together += 1
        elif any(one & group for one in held) and any(one & others for one in held):
            apart += 1
    return together, apart


def _background(scene: Scene) -> dict[str, Any]:
    """How much of the voxels that it voted for was new, background, or owned, before the frame."""
    voxel, owner, count, total = scene.shares
    known = scene.voxels[scene.voxels < len(total)]
    mine = np.isin(voxel, known)
    votes = Counter[int]()
    for instance, amount in zip(owner[mine].tolist(), count[mine].tolist(), strict=True):
        votes[instance] += amount
    everything = max(1, int(total[known].sum()))
    return {
        "voxels_without_votes": len(scene.voxels) - int((total[known] > 0).sum()),
        "share_of_votes": votes[0] / everything,
    }


def _history(scene: Scene, final: int) -> dict[str, Any]:
    """The instance's masks and events before and after this frame."""
    frame = scene.run.frames[scene.position].frame
    then = scene.row["instance"]
    events = events_of(scene.run, {then, final, scene.chosen} - {0})
    masks = [
        scene.run.frames[position].frame
        for position, row in scene.run.decisions()
        if row["instance"] == then or (final and scene.run.final[row["fragment"]] == final)
    ]
    return {
        "masks_before": sum(one < frame for one in masks),
        "masks_after": sum(one > frame for one in masks),
        "events_before": [event for event in events if event["frame"] < frame],
        "events_of_the_frame": [event for event in events if event["frame"] == frame],
        "events_after": [event for event in events if event["frame"] > frame],
    }
