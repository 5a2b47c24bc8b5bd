"""What the masks of a perception file look like as a whole, for `info`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from openvox.formats.perception import read_masks

SCORES = tuple(i / 10 for i in range(11))
AREAS = (0, 100, 400, 1_600, 6_400, 25_600, 102_400, 409_600)
"""Pixels; each four times the one before, so that a thing twice as near is a bin further."""
CAPTIONS = 10


def masks_summary(path: Path) -> dict[str, Any]:
    """Masks a frame, scores, areas, and the most common captions. Raises InputError for a damaged file."""
    scores, caption_scores, areas, per_frame = list[float](), list[float](), list[int](), list[int]()
    captions: Counter[tuple[str, bool]] = Counter()
    for found in read_masks(path):
        per_frame.append(len(found.masks))
        for mask in found.masks:
            scores.append(mask.score)
            caption_scores.append(mask.caption_score)
            areas.append(mask.area)
            captions[mask.caption or mask.label, mask.named] += 1
    common = sorted(captions.items(), key=lambda item: (-item[1], item[0]))[:CAPTIONS]
    return {
        "masks_a_frame": {
            "least": min(per_frame, default=0),
            "mean": sum(per_frame) / len(per_frame) if per_frame else 0.0,
            "most": max(per_frame, default=0),
        },
        "frames_without_masks": per_frame.count(0),
        "named": sum(count for (_, named), count in captions.items() if named),
        "captions": len(captions),
        "scores": _histogram(scores, SCORES),
        "caption_scores": _histogram(caption_scores, SCORES),
        "areas": _histogram(areas, AREAS),
        "most_common": [{"caption": text, "named": named, "masks": count} for (text, named), count in common],
    }


def _histogram(values: Sequence[float], edges: Sequence[float]) -> list[dict[str, float]]:
    """One row a bin from the first to the last that has something in it: from (inclusive), masks.

    The last edge takes what is above it, too. A score kept in 32 bits may be a little below the edge that it was."""
    where = np.searchsorted(edges, np.asarray(values) + 1e-6, side="right") - 1
    counts = np.bincount(where, minlength=len(edges)).tolist()
    used = [i for i, count in enumerate(counts) if count]
    return [{"from": edges[i], "masks": counts[i]} for i in range(used[0], used[-1] + 1)] if used else []
