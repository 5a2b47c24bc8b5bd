"""The kernels of the CPU engine, compiled by numba: votes in arrays that grow with the map."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from openvox.mapper import projection
from openvox.mapper.engines import pixels, votes
from openvox.mapper.engines.engine import Bools, Ints, Longs, Look, Region, View
from openvox.mapper.engines.pixels import EMPTY

Number = TypeVar("Number", np.int32, np.int64)
FIRST = 1 << 11
"""Room for so many voxels at first."""
NO_COLOR = projection.ColorLookup(np.zeros((3, 3), np.int64), np.zeros(3, np.int64), 0, 0, 0, 0)


class CpuKernels:
    """A hash table of rows over keys; a row is a voxel: its key, its background count, the head of a list of votes."""

    def __init__(self, slots: int) -> None:
        self.voxels = 0
        self._limit = slots
        self._room = 1 << 12
        self._keys = np.empty(FIRST, np.int64)
        self._table = pixels.rebuilt(self._keys, 0, 2 * FIRST)
        self._heads = np.empty(FIRST, np.int32)
        self._backgrounds = np.zeros(FIRST, np.int32)
        self._fragment = np.empty(FIRST, np.int32)
        self._count = np.empty(FIRST, np.int32)
        self._next = np.empty(FIRST, np.int32)
        self._slots = np.array([0, EMPTY], np.int64)  # used, first free
        self._number = np.full(1 << 10, EMPTY, np.int32)

    @property
    def _lists(self) -> tuple[Ints, Ints, Ints]:
        return self._fragment, self._count, self._next

    @property
    def bytes(self) -> int:
        """Memory of all arrays."""
        kept = (self._keys, self._table, self._heads, self._backgrounds, *self._lists, self._number)
        return sum(array.nbytes for array in kept)

    def count_pixels(self, view: View, labels: Ints) -> tuple[Longs, Ints, Ints, Ints]:
        """See `Kernels`."""
        color = view.color or NO_COLOR
        camera = np.array([color.fx, color.fy, color.cx, color.cy], np.int64)
        while True:
            *found, enough = pixels.count_pixels(
                view.depth, view.skip, labels, view.max_mm, view.rays.x, view.rays.y, view.transform.a,
                view.transform.b, view.transform.c, view.color is None, color.rotation, color.translation, camera,
                self._room,
            )  # fmt: skip
            if enough:
                keys, voxel, label, count = found
                return keys, voxel, label, count
            self._room *= 2

    def look_up(self, keys: Longs, hidden_evidence: int) -> tuple[Ints, Ints, Ints]:
        """See `Kernels`."""
        rows, owner, label = votes.look_up(
            keys, self._table, self._keys, self._heads, self._backgrounds, *self._lists, hidden_evidence, self._limit
        )
        return rows, owner, label

    def shares(
        self, rows: Ints, label: Ints, pair_voxel: Ints, pair_mask: Ints, masks: int, highest: int
    ) -> tuple[Ints, Longs, Longs]:
        """See `Kernels`."""
        self._number = _grown(self._number, highest + 1, EMPTY)
        found = np.empty(highest + 1, np.int32)
        n = votes.fragments_there(rows, self._heads, self._fragment, self._next, self._number, found)
        there: Ints = np.sort(found[:n])
        self._number[there] = np.arange(n, dtype=np.int32)
        theta_sum, overlap = votes.shares(
            pair_voxel, pair_mask, rows, label, masks, n, self._number, self._heads, self._backgrounds, *self._lists
        )
        self._number[there] = EMPTY
        return there, theta_sum, overlap

    def targets(self, region: Region, look: Look, held: Bools, main: Ints, undecided: Bools, voxel_votes: bool) -> Ints:
        """See `Kernels`."""
        self._number = _grown(self._number, int(look.fragments[-1]) + 1 if len(look.fragments) else 1, EMPTY)
        self._number[look.fragments] = np.arange(len(look.fragments), dtype=np.int32)
        target: Ints = votes.choose_targets(
            region.pair_voxel, region.pair_mask, look.rows, look.label, region.masks, self._number, held, main,
            undecided, held.any(0), voxel_votes, self._heads, *self._lists,
        )  # fmt: skip
        self._number[look.fragments] = EMPTY
        return target

    def add_rows(self, keys: Longs) -> None:
        """See `Kernels`."""
        before, total = self.voxels, self.voxels + len(keys)
        if total > len(self._keys):
            self._keys = _grown(self._keys, total, 0)
            self._heads = _grown(self._heads, total, EMPTY)
            self._backgrounds = _grown(self._backgrounds, total, 0)
        self._keys[before:total] = keys
        self._heads[before:total] = EMPTY
        self._backgrounds[before:total] = 0
        self.voxels = total
        size = len(self._table)
        while 5 * total > 3 * size:
            size *= 2
        if size > len(self._table):
            self._table = pixels.rebuilt(self._keys, total, size)
        else:
            pixels.insert_range(self._table, self._keys, before, total)

    def add_votes(self, rows: Ints, fragments: Ints, amounts: Ints) -> None:
        """See `Kernels`."""
        total = int(self._slots[0]) + len(rows)
        self._fragment = _grown(self._fragment, total, 0)
        self._count = _grown(self._count, total, 0)
        self._next = _grown(self._next, total, EMPTY)
        votes.add_votes(
            rows, fragments, amounts, self._heads, self._backgrounds, *self._lists, self._slots, self._limit
        )

    def move_votes(self, rows: Ints, source: int, target: int) -> None:
        """See `Kernels`."""
        votes.move_votes(rows, source, target, self._heads, self._fragment, self._next)

    def halve(self, rows: Ints, limit: int) -> tuple[Ints, Ints]:
        """See `Kernels`."""
        room = len(rows) + int(self._slots[0])
        row, fragment = np.empty(room, np.int32), np.empty(room, np.int32)
        n = votes.halve(rows, limit, self._heads, self._backgrounds, *self._lists, self._slots, row, fragment)
        return row[:n], fragment[:n]

    def counts_of(self, rows: Ints, fragments: Ints) -> Ints:
        """See `Kernels`."""
        counts: Ints = votes.counts_of(rows, fragments, self._heads, self._backgrounds, *self._lists)
        return counts

    def owners(self, rows: Ints) -> tuple[Ints, Ints]:
        """See `Kernels`."""
        owner, share = votes.owners(rows, self._heads, self._backgrounds, *self._lists, self._limit)
        return owner, share

    def votes(self) -> tuple[Longs, Ints, Ints, Ints]:
        """See `Kernels`."""
        row, fragment, count = votes.all_votes(
            self.voxels, self._heads, self._backgrounds, *self._lists, int(self._slots[0])
        )
        return self._keys[: self.voxels].copy(), row, fragment, count


def _grown(array: NDArray[Number], size: int, fill: int) -> NDArray[Number]:
    """The array with room for `size`, a quarter more at least when it grows."""
    if size <= len(array):
        return array
    out = np.full(max(size, len(array) + len(array) // 4), fill, array.dtype)
    out[: len(array)] = array
    return out
