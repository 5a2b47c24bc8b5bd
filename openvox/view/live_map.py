"""The map as an observer knows it: whose every voxel is after the last step, rebuilt from what steps tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import Step, VoxelChanges
from openvox.core.voxels import voxel_index, voxel_key
from openvox.view.votes import Votes

Number = TypeVar("Number", np.int32, np.int64)
Rows = NDArray[np.int64]
"""Numbers of voxels, in the order of their first vote."""
NONE = np.zeros(0, np.int64)


@dataclass(frozen=True, eq=False)
class Change:
    """What one step changed, as far as it can be seen."""

    moved: Mapping[int, int]
    """Voxels that came to or left each instance, by id ascending; 0 = background."""
    regrouped: tuple[int, ...]
    """Instances that gained or lost a whole fragment (new, merged, split), ascending."""
    touched: tuple[int, ...]
    """Instances of the voxels in which a count changed, ascending; 0 = background."""


class LiveMap:
    """Owner of every voxel, each fragment's voxels, and all votes; grows with the map, costs with the change."""

    def __init__(self) -> None:
        self.size = 0
        self.votes = Votes()
        self._key = np.zeros(0, np.int64)
        self._owner = np.zeros(0, np.int32)
        self._members: dict[int, Rows] = {}
        self.instance_of = np.zeros(1, np.int32)
        """Instance of every fragment, by id."""
        self._fragments: dict[int, list[int]] = {}

    def index_of(self, rows: Rows) -> NDArray[np.int32]:
        """(n, 3): floor(world / voxel_size) of these voxels."""
        return voxel_index(self._key[rows])

    def index(self) -> NDArray[np.int32]:
        """(size, 3): of every voxel."""
        return voxel_index(self._key[: self.size])

    def instances(self) -> NDArray[np.int32]:
        """(size,): instance of every voxel, 0 = background."""
        return self.instance_of[self._owner[: self.size]]

    def instances_of(self, rows: Rows) -> NDArray[np.int32]:
        """Instance of each of these voxels."""
        return self.instance_of[self._owner[rows]]

    def rows(self, instance: int) -> Rows:
        """The voxels of an instance, ascending: an old list begins a new one, which a file packs well."""
        parts = [self._members.get(fragment, NONE) for fragment in self._fragments.get(instance, [])]
        return np.sort(np.concatenate(parts)) if parts else NONE

    def order_of(self, index: NDArray[np.int32]) -> Rows:
        """What sorts these voxels as `rows` does. index: (n, 3), of voxels of this map."""
        key = self._key[: self.size]
        known = np.argsort(key)
        place = np.searchsorted(key, voxel_key(index.astype(np.int64)), sorter=known)
        return np.argsort(known[np.minimum(place, self.size - 1)], kind="stable")

    def count(self, instance: int) -> int:
        """Number of voxels of an instance."""
        return sum(len(self._members.get(fragment, NONE)) for fragment in self._fragments.get(instance, []))

    def populated(self) -> list[int]:
        """Instances that have a voxel, ascending."""
        return [instance for instance in sorted(self._fragments) if instance and self.count(instance)]

    def sureness(self, rows: Rows) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Of these voxels: the share of all votes that its instance has, and the entropy of the votes, bits."""
        return self.votes.look(rows, self.instances_of(rows), self.instance_of)

    def apply(self, step: Step) -> Change:
        """Take over what a step changed; steps come in order. The first one of a resumed map tells all of it."""
        changes = step.changes
        self._grow(changes)
        self.votes.apply(changes)
        before = self._regroup(step.instance_of)
        fragments = np.flatnonzero(before != self.instance_of)
        carried = [self._members.get(fragment, NONE) for fragment in fragments.tolist()]
        rows = np.unique(np.concatenate([changes.touched.astype(np.int64), *carried]))
        was = before[self._owner[rows]]
        self._write(changes)
        now = self.instance_of[self._owner[rows]]
        elsewhere, count = np.unique(np.concatenate([was[was != now], now[was != now]]), return_counts=True)
        return Change(
            moved=dict(zip(elsewhere.tolist(), count.tolist(), strict=True)),
            regrouped=tuple(np.unique([before[fragments], self.instance_of[fragments]]).tolist()),
            touched=tuple(np.unique(now).tolist()),
        )

    def _grow(self, changes: VoxelChanges) -> None:
        if changes.first_new != self.size:
            raise ValueError(f"step begins with {changes.first_new} voxels, {self.size} were told; steps must be whole")
        needed = self.size + len(changes.new_index)
        if needed > len(self._owner):
            room = max(needed, 2 * len(self._owner), 1024)
            self._key, self._owner = _enlarged(self._key, room), _enlarged(self._owner, room)
        self._key[self.size : needed] = voxel_key(changes.new_index.astype(np.int64))
        self.size = needed

    def _write(self, changes: VoxelChanges) -> None:
        """Take over owners, and keep each fragment's list of voxels: drop those that left, append others."""
        left = self._owner[changes.touched]
        self._owner[changes.touched] = changes.owner
        swapped = left != changes.owner
        rows, joined = changes.touched[swapped].astype(np.int64), changes.owner[swapped]
        for fragment in np.unique(np.concatenate([left[swapped], joined])).tolist():
            if fragment > 0:
                kept = self._members.get(fragment, NONE)
                kept = kept[self._owner[kept] == fragment]
                self._members[fragment] = np.concatenate([kept, rows[joined == fragment]])

    def _regroup(self, instance_of: Mapping[int, int]) -> NDArray[np.int32]:
        """Take over the instances of all fragments; returns the table before, as long as the one after."""
        largest = max(max(instance_of, default=0), len(self.instance_of) - 1)
        before = _enlarged(self.instance_of, largest + 1)
        after = np.zeros(largest + 1, np.int32)
        self._fragments = {}
        for fragment, instance in sorted(instance_of.items()):
            after[fragment] = instance
            self._fragments.setdefault(instance, []).append(fragment)
        self.instance_of = after
        return before


def _enlarged(array: NDArray[Number], length: int) -> NDArray[Number]:
    out = np.zeros((length, *array.shape[1:]), array.dtype)
    out[: len(array)] = array
    return out
