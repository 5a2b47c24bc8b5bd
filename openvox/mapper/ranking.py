"""How sure a finished map is of its instances: whether each exists, and in which order to believe them."""

from __future__ import annotations

from collections.abc import Mapping
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import FinishParameters
from openvox.mapper.codebook import Memory
from openvox.mapper.smoothing import Tally

Longs = NDArray[np.int64]
Ints = NDArray[np.int32]


def relative_scores(memories: Mapping[int, Memory]) -> dict[int, int]:
    """Each instance's mean detection score over that of all masks, at most 1, in Q20.

    What is a good score differs between detectors, but a phantom scores below what else the same detector finds."""
    scores = sum(memory.score for memory in memories.values())
    masks = sum(memory.observations for memory in memories.values())
    return {
        i: min(fixedpoint.Q20, ((memory.score * masks) << 20) // max(1, scores * memory.observations))
        for i, memory in memories.items()
    }


def vote_share(shown: Longs, tally: Tally) -> Longs:
    """(voxels,): theta of what each voxel shows, its votes over all votes, Q20."""
    share: Longs = (tally.own(shown) << 20) // np.maximum(tally.total, 1)
    return share


def vote_overlaps(shown: Longs, tally: Tally) -> dict[int, int]:
    """The overlap of votes of each shown instance, Q20, ids ascending: its votes in its voxels, over all votes in them
    and its own elsewhere."""
    inside, everything = sums(shown, tally.own(shown)), sums(shown, tally.total)
    votes = sums(tally.instance, tally.count)
    out = {}
    for i in np.unique(shown[shown > 0]).tolist():
        out[i] = (inside[i] << 20) // max(1, everything[i] + votes[i] - inside[i])
    return out


def existence(shown: Longs, tally: Tally, memories: Mapping[int, Memory]) -> dict[int, int]:
    """How surely each shown instance is a thing, Q20: the overlap of its votes x k/(k+2) x the root of k/v x the square
    of its relative score (k frames matched, v frames that saw it).

    The root, as what is hard to see is often missed."""
    scores = relative_scores(memories)
    out = {}
    for i, overlap in vote_overlaps(shown, tally).items():
        k, v = memories[i].matched, max(1, memories[i].seen)
        root = isqrt((k << 40) // v)
        out[i] = overlap * root * k * scores[i] ** 2 // (k + 2) >> 60
    return out


def confidences(
    shown: Longs, tally: Tally, beside: Ints, memories: Mapping[int, Memory], parameters: FinishParameters
) -> dict[int, int]:
    """The confidence of each shown instance by `finish.ranking`, Q20, ids ascending. beside: see face_neighbours."""
    if parameters.existence and parameters.ranking == "overlap":
        return expected_overlap(shown, tally, beside, memories)
    if parameters.existence and parameters.ranking == "existence":
        return existence(shown, tally, memories)
    share, sizes = sums(shown, vote_share(shown, tally)), np.bincount(shown).tolist()
    theta = {i: share[i] // sizes[i] for i in range(1, len(sizes)) if sizes[i]}
    if parameters.existence and parameters.ranking == "matches":
        return {i: mean * memories[i].matched // (memories[i].matched + 2) for i, mean in theta.items()}
    return theta


def expected_overlap(shown: Longs, tally: Tally, beside: Ints, memories: Mapping[int, Memory]) -> dict[int, int]:
    """The overlap with a true thing that each shown instance may hope for, Q20: that of its votes x (p - d)/(p + d) x
    k/(k+2) x its relative score (k frames matched).

    Errors lie at the outline. Of the p faces between its voxels and voxels of the map, those to something else are in
    doubt as far as the votes on either side disagree, d in sum: if so much of it is wrong, and as much is missing, the
    overlap is (p - d)/(p + d)."""
    scores = relative_scores(memories)
    faces, doubt = _outlines(shown, beside, fixedpoint.Q20 - vote_share(shown, tally))
    out = {}
    for i, overlap in vote_overlaps(shown, tally).items():
        k, p, d = memories[i].matched, faces[i] << 20, doubt[i]
        out[i] = overlap * scores[i] * k * max(0, p - d) // ((k + 2) * max(1, p + d)) >> 20
    return out


def _outlines(shown: Longs, beside: Ints, unsure: Longs) -> tuple[list[int], list[int]]:
    """By instance: faces of its voxels to voxels of the map, and what is unsure on both sides of those that lead to
    something else. A face between two of its voxels counts for both. unsure (voxels,): share of votes for other than
    what the voxel shows, Q20."""
    size = int(shown.max(initial=0)) + 1
    faces, doubt = np.zeros(size, np.int64), np.zeros(size, np.int64)
    for face in beside:
        here = np.flatnonzero((shown > 0) & (face >= 0))
        there = face[here]
        faces += np.bincount(shown[here], minlength=size)
        rim = shown[here] != shown[there]
        np.add.at(doubt, shown[here[rim]], unsure[here[rim]] + unsure[there[rim]])
    return faces.tolist(), doubt.tolist()


def sums(instance: NDArray[np.integer], values: Longs) -> list[int]:
    """Sum of the values of each instance, by id."""
    out = np.zeros(int(instance.max(initial=0)) + 1, np.int64)
    np.add.at(out, instance, values)
    return out.tolist()
