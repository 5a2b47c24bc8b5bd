"""How sure each voxel is: the share of its votes that its instance has, and the entropy of all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import InstanceMap, VoxelChanges

Longs = NDArray[np.int64]
Numbers = NDArray[np.float32]
NAMELESS = -1
"""Votes that belong to no fragment and count in totals only."""


class Votes:
    """All votes of a map by voxel, then fragment. What steps tell is put in order only when somebody asks."""

    def __init__(self) -> None:
        self._key = np.zeros(0, np.int64)  # voxel << 32 | fragment - NAMELESS
        self._count = np.zeros(0, np.int32)
        self._waiting: list[tuple[Longs, NDArray[np.int32]]] = []

    def add(self, voxel: Longs, fragment: NDArray[np.int32], count: NDArray[np.int32]) -> None:
        """The counts that these pairs of voxel number and fragment have from now on."""
        self._waiting.append(((voxel << 32) | (fragment.astype(np.int64) - NAMELESS), count))

    def apply(self, changes: VoxelChanges) -> None:
        """Take over what a step changed."""
        self.add(changes.voxel.astype(np.int64), changes.fragment, changes.count)

    def look(self, rows: Longs, own: NDArray[np.int32], instance_of: NDArray[np.int32]) -> tuple[Numbers, Numbers]:
        """Share and entropy of these voxels, as `shares_and_entropies` has them.

        own: the instance of each; instance_of: by fragment, as an array."""
        group, fragment, count = self.of(rows)
        return shares_and_entropies(group, instance_of[np.maximum(fragment, 0)], count, own)

    def of(self, rows: Longs) -> tuple[Longs, Longs, NDArray[np.int32]]:
        """All votes of these voxels: the place in `rows` of each one's voxel, its fragment, its count."""
        self._settle()
        first, last = np.searchsorted(self._key, [rows << 32, (rows + 1) << 32])
        length = last - first
        group = np.repeat(np.arange(len(rows)), length)
        entry = np.arange(len(group)) + np.repeat(first - (np.cumsum(length) - length), length)
        return group, (self._key[entry] & 0xFFFFFFFF) + NAMELESS, self._count[entry]

    def _settle(self) -> None:
        if not self._waiting:
            return
        key, count = (np.concatenate([pair[i] for pair in self._waiting]) for i in (0, 1))
        self._waiting = []
        order = np.argsort(key, kind="stable")
        order = order[np.append(key[order][1:] != key[order][:-1], True)] if len(order) else order  # the last one told
        key, count = key[order], count[order]
        place = np.searchsorted(self._key, key)
        known = place < len(self._key)
        known[known] = self._key[place[known]] == key[known]
        self._count[place[known]] = count[known]
        self._key = np.insert(self._key, place[~known], key[~known])
        self._count = np.insert(self._count, place[~known], count[~known])


def finished_entropies(result: InstanceMap) -> Numbers:
    """Entropy of every voxel of a finished map, bits; votes for what was dropped count as background."""
    table = np.zeros(int(result.fragment_id.max(initial=0)) + 1, np.int32)
    table[result.fragment_id] = result.fragment_instance
    group = np.repeat(np.arange(len(result.voxel_index)), np.diff(result.vote_offset))
    instance = table[np.maximum(result.vote_fragment, 0)]
    return shares_and_entropies(group, instance, result.vote_count, result.voxel_instance)[1]


def shares_and_entropies(
    group: Longs, instance: NDArray[np.int32], count: NDArray[np.int32], own: NDArray[np.int32]
) -> tuple[Numbers, Numbers]:
    """Of every voxel: the share of its votes that `own` has, and the entropy of the votes by instance, bits.

    group: voxel of each vote, 0 .. len(own) - 1; instance, count: of each vote, 0 = background. No votes: 0, 0."""
    pair, where = np.unique((group << 32) | instance.astype(np.int64), return_inverse=True)
    votes = np.bincount(where, count, len(pair))
    voxel = pair >> 32
    part = votes / np.maximum(np.bincount(voxel, votes, len(own)), 1)[voxel]
    mine = (pair & 0xFFFFFFFF) == own[voxel]
    share = np.bincount(voxel[mine], part[mine], len(own))
    bits = -part * np.log2(np.where(part > 0, part, 1.0))
    return share.astype(np.float32), np.bincount(voxel, bits, len(own)).astype(np.float32)
