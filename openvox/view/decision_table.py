"""This frame's decisions as a table for people and as columns for programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from openvox.core.fixedpoint import Q20
from openvox.core.types import Decision, Mask, Step
from openvox.view.labels import shortened

Q12 = 1 << 12
CAPTION = 24
"""Letters of a caption in the table; the whole one is in the data."""
NONE = "-"
HEAD = "| # | caption | instance | decided by | A / threshold | S_geo | S_fea | next best (A) | R | w |"
RULE = "|---:|:---|---:|:---|---:|---:|---:|---:|---:|---:|"
LEGEND = (
    "#: mask; S_geo, S_fea: similarity of mask and instance in space and in words; A: the probability that they belong "
    "together; next best: the best other candidate; R: visibility ratio; w: credibility of this observation."
)


def markdown(step: Step) -> str:
    """A table, one row a mask: where it went, the rule that decided, its scores, and the best other candidate."""
    title = f"### Frame {step.frame.index}\n\n"
    if not step.looked:
        return title + "Perception did not look at this frame; the map is unchanged.\n"
    if not step.decisions:
        return title + "Perception found no mask in this frame.\n"
    rows = [_row(decision, step.masks[decision.mask]) for decision in step.decisions]
    return title + "\n".join([HEAD, RULE, *rows]) + f"\n\n{LEGEND}\n"


def _row(decision: Decision, mask: Mask) -> str:
    scores = (decision.s_geo, decision.s_fea, decision.a)  # all 0 with an instance that is new
    s_geo, s_fea, a = (f"{score / Q20:.2f}" if any(scores) else NONE for score in scores)
    others = [candidate for candidate in decision.candidates if candidate.instance != decision.instance]
    cells = [
        str(decision.mask),
        escaped(shortened(mask.caption or mask.label, CAPTION)),
        f"**{decision.instance}**" if decision.instance else NONE,
        decision.by,
        f"{a} / {decision.threshold / Q20:.2f}",
        s_geo,
        s_fea,
        f"{others[0].instance} ({others[0].a / Q20:.2f})" if others else NONE,
        f"{decision.visibility / Q20:.2f}" if decision.instance else NONE,
        f"{decision.credibility / Q12:.2f}" if decision.instance else NONE,
    ]
    return f"| {' | '.join(cells)} |"


def escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    return "".join(f"\\{letter}" if letter in "\\`*_[]<>|#&~" else letter for letter in text)


def columns(step: Step) -> Mapping[str, Any]:
    """Name to one value a decision: numbers as they are, scores and credibility not as Q20, Q12 but as float32, which
    holds them exactly."""
    decisions = step.decisions
    masks = [step.masks[decision.mask] for decision in decisions]
    scores = ("s_geo", "s_fea", "a", "threshold", "visibility")
    counts = ("mask", "instance", "fragment", "voxels", "abstained")
    return {
        **{name: np.array([getattr(decision, name) for decision in decisions], np.int32) for name in counts},
        "caption": [mask.caption for mask in masks],
        "by": [decision.by for decision in decisions],
        **{name: np.array([getattr(decision, name) / Q20 for decision in decisions], np.float32) for name in scores},
        "credibility": np.array([decision.credibility / Q12 for decision in decisions], np.float32),
    }


def candidate_columns(step: Step) -> Mapping[str, Any]:
    """Name to one value a candidate of any mask, in the order of masks, the best candidate first."""
    pairs = [(decision.mask, candidate) for decision in step.decisions for candidate in decision.candidates]
    return {
        "mask": np.array([mask for mask, _ in pairs], np.int32),
        **{name: np.array([getattr(one, name) for _, one in pairs], np.int32) for name in ("instance", "overlap")},
        **{
            name: np.array([getattr(one, name) / Q20 for _, one in pairs], np.float32)
            for name in ("s_geo", "s_fea", "a")
        },
    }


def margins(step: Step) -> tuple[float, float] | None:
    """The least margins of the frame: best A minus threshold (nearest to 0, with its sign), best minus second best A.

    None if no mask had a candidate. A single candidate is compared with a second best of 0."""
    best = [decision for decision in step.decisions if decision.candidates]
    if not best:
        return None
    over = min((decision.candidates[0].a - decision.threshold for decision in best), key=abs)
    ahead = min(d.candidates[0].a - (d.candidates[1].a if len(d.candidates) > 1 else 0) for d in best)
    return over / Q20, ahead / Q20
