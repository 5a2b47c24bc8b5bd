"""How sure a finished map is of its instances: whether each exists, and in which order to believe them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.voxels import rows_of, voxel_index, voxel_key
from openvox.mapper.codebook import Memory

Longs = NDArray[np.int64]
FACES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


def relative_scores(memories: Mapping[int, Memory]) -> dict[int, int]:
    """Each instance's mean detection score over that of all masks, at most 1, in Q20.

    What is a good score differs between detectors, but a phantom scores below what else the same detector finds."""
    scores = sum(memory.score for memory in memories.values())
    masks = sum(memory.observations for memory in memories.values())
    return {
        i: min(fixedpoint.Q20, ((memory.score * masks) << 20) // max(1, scores * memory.observations))
        for i, memory in memories.items()
    }


def vote_shares(shown: Longs, own: Longs, total: Longs, votes: Sequence[int]) -> dict[int, int]:
    """The overlap of votes of each shown instance, Q20, ids ascending: its votes in its voxels, over all votes in them
    and its own elsewhere.

    own, total (voxels,): votes for what the voxel shows, and all; votes: all of each instance, by id."""
    inside, everything = sums(shown, own), sums(shown, total)
    out = {}
    for i in np.unique(shown[shown > 0]).tolist():
        out[i] = (inside[i] << 20) // max(1, everything[i] + votes[i] - inside[i])
    return out


def existence(shares: Mapping[int, int], memories: Mapping[int, Memory], scores: Mapping[int, int]) -> dict[int, int]:
    """How surely each shown instance is a thing, Q20: the overlap of its votes x k/(k+2) x the root of k/v x the square
    of its relative score (k frames matched, v frames that saw it).

    The root, as what is hard to see is often missed."""
    out = {}
    for i, share in shares.items():
        k, v = memories[i].matched, max(1, memories[i].seen)
        root = isqrt((k << 40) // v)
        out[i] = share * root * k * scores[i] ** 2 // (k + 2) >> 60
    return out


def expected_overlap(
    shown: Longs,
    keys: Longs,
    unsure: Longs,
    shares: Mapping[int, int],
    memories: Mapping[int, Memory],
    scores: Mapping[int, int],
) -> dict[int, int]:
    """The overlap with a true thing that each shown instance may hope for, Q20: that of its votes x (p - d)/(p + d) x
    k/(k+2) x its relative score (k frames matched).

    Errors lie at the outline. Of the p faces between its voxels and voxels of the map, those to something else are in
    doubt as far as the votes on either side disagree, d in sum: if so much of it is wrong, and as much is missing, the
    overlap is (p - d)/(p + d). unsure (voxels,): share of votes for other than what the voxel shows, Q20."""
    faces, doubt = _outlines(shown, keys, unsure)
    out = {}
    for i, share in shares.items():
        k, p, d = memories[i].matched, faces[i] << 20, doubt[i]
        out[i] = share * scores[i] * k * max(0, p - d) // ((k + 2) * max(1, p + d)) >> 20
    return out


def _outlines(shown: Longs, keys: Longs, unsure: Longs) -> tuple[list[int], list[int]]:
    """By instance: faces of its voxels to voxels of the map, and what is unsure on both sides of those that lead to
    something else. A face between two of its voxels counts for both."""
    size = int(shown.max(initial=0)) + 1
    faces, doubt = np.zeros(size, np.int64), np.zeros(size, np.int64)
    rows = np.flatnonzero(shown > 0)
    index = voxel_index(keys[rows]).astype(np.int64)
    for face in FACES:
        other = rows_of(keys, voxel_key(index + np.array(face)))
        here, there = rows[other >= 0], other[other >= 0]
        faces += np.bincount(shown[here], minlength=size)
        rim = shown[here] != shown[there]
        np.add.at(doubt, shown[here[rim]], unsure[here[rim]] + unsure[there[rim]])
    return faces.tolist(), doubt.tolist()


def sums(instance: NDArray[np.integer], values: Longs) -> list[int]:
    """Sum of the values of each instance, by id."""
    out = np.zeros(int(instance.max(initial=0)) + 1, np.int64)
    np.add.at(out, instance, values)
    return out.tolist()
