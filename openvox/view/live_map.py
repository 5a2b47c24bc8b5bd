"""The map as an observer knows it: voxel states and instances after the last step, rebuilt from what steps tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from openvox.core.fixedpoint import Q20
from openvox.core.types import Step, VoxelChanges

Number = TypeVar("Number", np.int32, np.uint8)
Rows = NDArray[np.int64]
"""Numbers of voxels, in the order of their first vote."""
NONE = np.zeros(0, np.int64)


@dataclass(frozen=True, eq=False)
class Change:
    """What one step changed, as far as it can be seen."""

    first_new: int
    """Number of the first new voxel."""
    rows: Rows
    """Voxels whose instance or whose owner's share, in percent, is another now, ascending; new voxels included."""
    moved: Mapping[int, int]
    """Voxels that came to or left each instance, by id ascending; 0 = background."""
    regrouped: tuple[int, ...]
    """Instances that gained or lost a whole fragment (new, merged, split), ascending."""


class LiveMap:
    """Owner and share of every voxel, and each fragment's voxels; grows with the map, costs with the change."""

    def __init__(self) -> None:
        self.size = 0
        self._index = np.zeros((0, 3), np.int32)
        self._owner = np.zeros(0, np.int32)
        self._percent = np.zeros(0, np.uint8)
        self._members: dict[int, Rows] = {}
        self._instance_of = np.zeros(1, np.int32)
        self._fragments: dict[int, list[int]] = {}

    @property
    def index(self) -> NDArray[np.int32]:
        """(size, 3): floor(world / voxel_size) of every voxel."""
        return self._index[: self.size]

    @property
    def percent(self) -> NDArray[np.uint8]:
        """(size,): the owner's share of all votes."""
        return self._percent[: self.size]

    def instances(self) -> NDArray[np.int32]:
        """(size,): instance of every voxel, 0 = background."""
        return self._instance_of[self._owner[: self.size]]

    def instances_of(self, rows: Rows) -> NDArray[np.int32]:
        """Instance of each of these voxels."""
        return self._instance_of[self._owner[rows]]

    def rows(self, instance: int) -> Rows:
        """The voxels of an instance, ascending."""
        parts = [self._members.get(fragment, NONE) for fragment in self._fragments.get(instance, [])]
        return np.sort(np.concatenate(parts)) if parts else NONE

    def populated(self) -> list[int]:
        """Instances that have a voxel, ascending."""
        return [
            instance
            for instance, fragments in sorted(self._fragments.items())
            if any(len(self._members.get(fragment, NONE)) for fragment in fragments)
        ]

    def apply(self, step: Step) -> Change:
        """Take over what a step changed; steps come in order, from the first."""
        changes = step.changes
        self._grow(changes)
        before = self._regroup(step.instance_of)
        fragments = np.flatnonzero(before != self._instance_of)
        carried = [self._members.get(fragment, NONE) for fragment in fragments.tolist()]
        rows = np.unique(np.concatenate([changes.touched.astype(np.int64), *carried]))
        was, percent = before[self._owner[rows]], self._percent[rows]
        self._write(changes)
        now = self._instance_of[self._owner[rows]]
        elsewhere, count = np.unique(np.concatenate([was[was != now], now[was != now]]), return_counts=True)
        different = (was != now) | (percent != self._percent[rows]) | (rows >= changes.first_new)
        return Change(
            first_new=changes.first_new,
            rows=rows[different],
            moved=dict(zip(elsewhere.tolist(), count.tolist(), strict=True)),
            regrouped=tuple(np.unique([before[fragments], self._instance_of[fragments]]).tolist()),
        )

    def _grow(self, changes: VoxelChanges) -> None:
        if changes.first_new != self.size:
            raise ValueError(f"step begins with {changes.first_new} voxels, {self.size} were told; steps must be whole")
        needed = self.size + len(changes.new_index)
        if needed > len(self._owner):
            room = max(needed, 2 * len(self._owner), 1024)
            self._index = _enlarged(self._index, room)
            self._owner, self._percent = _enlarged(self._owner, room), _enlarged(self._percent, room)
        self._index[self.size : needed] = changes.new_index
        self.size = needed

    def _write(self, changes: VoxelChanges) -> None:
        """Take over owners and shares, and keep each fragment's list of voxels: drop those that left, append others."""
        left = self._owner[changes.touched]
        self._owner[changes.touched], self._percent[changes.touched] = changes.owner, percent_of(changes.share)
        swapped = left != changes.owner
        rows, joined = changes.touched[swapped].astype(np.int64), changes.owner[swapped]
        for fragment in np.unique(np.concatenate([left[swapped], joined])).tolist():
            if fragment > 0:
                kept = self._members.get(fragment, NONE)
                kept = kept[self._owner[kept] == fragment]
                self._members[fragment] = np.concatenate([kept, rows[joined == fragment]])

    def _regroup(self, instance_of: Mapping[int, int]) -> NDArray[np.int32]:
        """Take over the instances of all fragments; returns the table before, as long as the one after."""
        largest = max(max(instance_of, default=0), len(self._instance_of) - 1)
        before = _enlarged(self._instance_of, largest + 1)
        after = np.zeros(largest + 1, np.int32)
        self._fragments = {}
        for fragment, instance in sorted(instance_of.items()):
            after[fragment] = instance
            self._fragments.setdefault(instance, []).append(fragment)
        self._instance_of = after
        return before


def percent_of(share: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Shares in Q20, rounded half up to whole percents."""
    return ((share.astype(np.int64) * 100 + (Q20 >> 1)) >> 20).astype(np.uint8)


def _enlarged(array: NDArray[Number], length: int) -> NDArray[Number]:
    out = np.zeros((length, *array.shape[1:]), array.dtype)
    out[: len(array)] = array
    return out
