"""The decisions most likely wrong, by what the whole run knows in the end.

The rule: score = elsewhere x unlike. *Elsewhere* is the share of the voxels that the mask voted for which do not
show the mask's instance in the end. *Unlike* is one minus the likeness of its caption to those of all masks of its
instance: the mean, over its words, of the share of those masks that have the word. Either alone is no fault (a rim
that went to background; a synonym), both together seldom are none. Instances that finishing dropped do no harm and are
left out.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from openvox.apps.explaining.run import Longs, Row, Run, words_of
from openvox.core.fixedpoint import Q20

RULE = (
    "score = (share of the mask's voxels that show something else in the end) x (how unlike its caption is to those of "
    "its instance)"
)
PER_INSTANCE = 3
"""So many decisions of one instance come before others of it: one welded instance would fill the list."""
UNKNOWN = 0.5
"""Likeness of a mask without a caption."""
SMALL_MARGIN = 0.1


@dataclass(frozen=True, slots=True)
class Suspect:
    """One decision with what speaks against it."""

    position: int
    row: Row
    instance: int
    """Its instance after the last frame."""
    voxels: int
    """Voxels that gained votes by it."""
    shown: Mapping[int, int]
    """What those voxels show in the end: voxels by instance, 0 = background."""
    likeness: float

    @property
    def elsewhere(self) -> float:
        """Share of its voxels that do not show its instance in the end."""
        return 1.0 - self.shown.get(self.instance, 0) / self.voxels if self.voxels else 1.0

    @property
    def score(self) -> float:
        """0 (nothing speaks against it) to 1."""
        return self.elsewhere * (1.0 - self.likeness)


def suspicious(run: Run, top: int) -> dict[str, Any]:
    """The contract's fields of `explain --suspicious`: the rule, and the worst decisions first, each with reasons."""
    captions = captions_in_the_end(run)
    ranked = sorted(_suspects(run, captions), key=lambda one: (-one.score, one.position, one.row["mask"]))
    listed = spread([one for one in ranked if one.score > 0])[:top]
    return {"rule": RULE, "decisions": [_described(run, one, captions) for one in listed]}


def captions_in_the_end(run: Run) -> dict[int, Counter[str]]:
    """Captions of all masks by their instance in the end, with how many masks have each."""
    out: dict[int, Counter[str]] = {}
    for _, row in run.decisions():
        out.setdefault(run.final[row["fragment"]], Counter())[row["caption"]] += 1
    return out


def spread(ranked: Sequence[Suspect]) -> list[Suspect]:
    """At most PER_INSTANCE of each instance first, the others behind them; else in the given order."""
    seen: Counter[int] = Counter()
    early: list[Suspect] = []
    late: list[Suspect] = []
    for one in ranked:
        seen[one.instance] += 1
        (early if seen[one.instance] <= PER_INSTANCE else late).append(one)
    return early + late


def likeness(caption: str, words: Mapping[str, int], masks: int) -> float:
    """Mean, over the words of a caption, of the share of masks that have the word. words: masks that have each."""
    own = words_of(caption)
    return sum(words.get(word, 0) for word in sorted(own)) / (masks * len(own)) if own and masks else UNKNOWN


def words_in(captions: Mapping[str, int]) -> Counter[str]:
    """How many masks have each word."""
    out: Counter[str] = Counter()
    for caption, masks in captions.items():
        out.update(dict.fromkeys(words_of(caption), masks))
    return out


def _suspects(run: Run, captions: Mapping[int, Counter[str]]) -> list[Suspect]:
    words = {instance: words_in(found) for instance, found in captions.items()}
    masks = {instance: found.total() for instance, found in captions.items()}
    out = []
    for position, row in run.decisions():
        instance = run.final[row["fragment"]]
        if instance in run.dropped:
            continue
        voted = run.cast(position, row["held"])
        alike = likeness(row["caption"], words[instance], masks[instance])
        out.append(Suspect(position, row, instance, len(voted), _shown(run.final_owner[voted]), alike))
    return out


def _shown(owners: Longs) -> dict[int, int]:
    ids, voxels = np.unique(owners, return_counts=True)
    return dict(zip(ids.tolist(), voxels.tolist(), strict=True))


def _described(run: Run, one: Suspect, captions: Mapping[int, Counter[str]]) -> dict[str, Any]:
    return {
        "frame": run.frames[one.position].frame,
        "mask": one.row["mask"],
        "instance": one.instance,
        "score": one.score,
        "reason": "; ".join(_reasons(run, one, captions)),
        "caption": one.row["caption"],
        "by": one.row["by"],
        "elsewhere": one.elsewhere,
        "likeness": one.likeness,
    }


def _reasons(run: Run, one: Suspect, captions: Mapping[int, Counter[str]]) -> list[str]:
    """What speaks against a decision, in words: the two parts of the score first, then what else is odd about it."""
    row, found = one.row, captions[one.instance]
    usual = min(found, key=lambda caption: (-found[caption], caption))
    away = {i: n for i, n in one.shown.items() if i != one.instance}
    place = ""
    if away:
        most = min(away, key=lambda i: (-away[i], i))
        name = f"instance {most}" if most else "background"
        place = f", {away[most]} of them {name}"
    out = [f"{round(100 * one.elsewhere)} % of its {one.voxels} voxels show something else in the end{place}"]
    if row["caption"] and usual != row["caption"]:
        out.append(f'it says "{row["caption"]}", {found[usual]} of {found.total()} masks there say "{usual}"')
    return out + signs(row, run.final)


def signs(row: Row, instance_of: Mapping[int, int]) -> list[str]:
    """What is odd about a decision at the time it was made, in words.

    instance_of: of every fragment, to tell whether the held fragments are several instances."""
    out = []
    joined = row["by"] in ("containment", "threshold")
    chosen = next((c for c in row["candidates"] if joined and c["a"] == row["a"] and c["s_geo"] == row["s_geo"]), None)
    rivals = [c for c in row["candidates"] if c is not chosen]
    if row["by"] == "containment" and row["a"] <= row["threshold"]:
        out.append(f"containment overruled the threshold: its A is {row['a'] / Q20:.2f}")
    if row["by"] == "new" and rivals and rivals[0]["a"] > row["threshold"]:
        out.append(f"it is new although A of instance {rivals[0]['instance']} is {rivals[0]['a'] / Q20:.2f}")
    if chosen and rivals and chosen["a"] - rivals[0]["a"] < SMALL_MARGIN * Q20:
        better = "more" if rivals[0]["a"] > chosen["a"] else "nearly as much"
        out.append(f"A speaks {better} for instance {rivals[0]['instance']}: {rivals[0]['a'] / Q20:.2f}")
    fits = max(rivals, key=lambda c: (c["s_fea"], -c["instance"]), default=None)
    if chosen and fits and fits["s_fea"] > chosen["s_fea"]:
        out.append(f"its caption fits instance {fits['instance']} better")
    if len({instance_of.get(f, f) for f in row["held"]}) > 1:
        out.append("it lies over several instances")
    if 4 * row["abstained"] > row["voxels"]:
        out.append(f"{row['abstained']} of its {row['voxels']} voxels abstained")
    return out
