"""The kernels as one would first write them: plain numpy, the votes in one sorted array. A measure, not an engine."""

from __future__ import annotations

import numpy as np

from openvox.core.voxels import RANGE
from openvox.mapper import equations
from openvox.mapper.engines.engine import Bools, Engine, Ints, Longs, Look, Region, View
from openvox.mapper.engines.pixels import EMPTY
from openvox.mapper.mapper import Mapper

LOW = 0xFFFFFFFF


class NumpyKernels:
    """Keys in order of rows and sorted beside them; votes as (row << 32) | fragment, ascending, 0 = background.

    One camera for depth and colour, and no limit of ids, as preset openvox on a registered recording needs."""

    def __init__(self) -> None:
        self._keys, self._sorted, self._row = (np.zeros(0, np.int64) for _ in range(3))
        self._packed, self._count = np.zeros(0, np.int64), np.zeros(0, np.int64)

    @property
    def voxels(self) -> int:
        return len(self._keys)

    @property
    def bytes(self) -> int:
        return sum(a.nbytes for a in (self._keys, self._sorted, self._row, self._packed, self._count))

    def count_pixels(self, view: View, labels: Ints) -> tuple[Longs, Ints, Ints, Ints]:
        assert view.color is None
        z = view.depth.astype(np.int64)
        use = (z > 0) & (z <= view.max_mm) & (view.skip == 0) & (labels >= 0)
        v, u = np.nonzero(use)
        z, x, y = z[use], view.rays.x[u], view.rays.y[v]
        a, b, c = view.transform.a, view.transform.b, view.transform.c
        key = np.zeros_like(z)
        for i in range(3):
            place = ((z * (a[i, 0] * x + a[i, 1] * y + (a[i, 2] << 18)) + c[i]) >> 46) + b[i] + RANGE
            key = (key << 21) | place
        keys, voxel = np.unique(key, return_inverse=True)
        packed, pixels = np.unique((voxel << 32) | labels[use], return_counts=True)
        return keys, _ints(packed >> 32), _ints(packed & LOW), _ints(pixels)

    def look_up(self, keys: Longs, hidden_evidence: int) -> tuple[Ints, Ints, Ints]:
        rows = np.full(len(keys), EMPTY, np.int64)
        if len(self._sorted):
            where = np.minimum(np.searchsorted(self._sorted, keys), len(self._sorted) - 1)
            rows = np.where(self._sorted[where] == keys, self._row[where], EMPTY)
        best, votes, background, _ = self._strongest(rows)
        owner, label = np.where(votes > background, best, 0), np.where(hidden_evidence * votes > background, best, 0)
        return _ints(rows), _ints(owner), _ints(label)

    def shares(
        self, rows: Ints, label: Ints, pair_voxel: Ints, pair_mask: Ints, masks: int, highest: int
    ) -> tuple[Ints, Longs, Longs]:
        _, entry = self._entries(rows)
        there = np.unique(self._packed[entry] & LOW)
        there = there[there > 0]
        own = label[pair_voxel]
        overlap, theta_sum = np.zeros((2, masks + 1, len(there)), np.int64)
        np.add.at(overlap, (pair_mask[own > 0], np.searchsorted(there, own[own > 0])), 1)
        under = pair_mask < masks
        voxel, mask = pair_voxel[under], pair_mask[under]
        pair, entry = self._entries(rows[voxel])
        named = self._packed[entry] & LOW > 0
        pair, entry = pair[named], entry[named]
        theta = equations.instance_vector(self._count[entry], self._strongest(rows)[3][voxel][pair])
        np.add.at(theta_sum, (mask[pair], np.searchsorted(there, self._packed[entry] & LOW)), theta)
        return _ints(there), theta_sum, overlap

    def targets(self, region: Region, look: Look, held: Bools, main: Ints, undecided: Bools, voxel_votes: bool) -> Ints:
        assert voxel_votes
        voxel, mask, columns = region.pair_voxel, region.pair_mask, len(look.fragments)
        holds = np.zeros((region.masks + 1, columns + 1), np.bool_)
        holds[:-1, :-1] = held
        own = look.label[voxel]
        column = np.where(own > 0, np.searchsorted(look.fragments, own), columns)
        pair, entry = self._entries(np.where(mask < region.masks, look.rows[voxel], EMPTY))
        fragment = self._packed[entry] & LOW
        known = (fragment > 0) & holds[mask[pair], np.searchsorted(look.fragments, fragment)]
        rank = np.zeros(len(voxel), np.int64)
        np.maximum.at(rank, pair[known], (self._count[entry[known]] << 32) | (LOW - fragment[known]))
        target = np.where(np.append(undecided, False)[mask], EMPTY, np.append(main, EMPTY)[mask])
        target = np.where(rank > 0, LOW - (rank & LOW), target)
        target = np.where(holds[mask, column], own, target)
        left_out = (own == 0) | holds.any(0)[column]
        return _ints(np.where(mask < region.masks, target, np.where(left_out, 0, EMPTY)))

    def add_rows(self, keys: Longs) -> None:
        place = np.searchsorted(self._sorted, keys)
        self._row = np.insert(self._row, place, np.arange(self.voxels, self.voxels + len(keys)))
        self._sorted = np.insert(self._sorted, place, keys)
        self._keys = np.append(self._keys, keys)

    def add_votes(self, rows: Ints, fragments: Ints, amounts: Ints) -> None:
        wanted, where = np.unique((rows.astype(np.int64) << 32) | fragments, return_inverse=True)
        place = np.searchsorted(self._packed, wanted)
        new = np.append(self._packed, -1)[place] != wanted
        self._packed = np.insert(self._packed, place[new], wanted[new])
        self._count = np.insert(self._count, place[new], 0)
        np.add.at(self._count, np.searchsorted(self._packed, wanted)[where], amounts)

    def move_votes(self, rows: Ints, source: int, target: int) -> None:
        place = np.searchsorted(self._packed, (rows.astype(np.int64) << 32) | source)
        count = self._count[place]
        self._packed, self._count = np.delete(self._packed, place), np.delete(self._count, place)
        self.add_votes(rows, np.full_like(rows, target), _ints(count))

    def halve(self, rows: Ints, limit: int) -> tuple[Ints, Ints]:
        full = rows[self._strongest(rows)[3] > limit]
        _, entry = self._entries(full)
        changed = self._packed[entry]
        self._count[entry] >>= 1
        gone = entry[self._count[entry] == 0]
        self._packed, self._count = np.delete(self._packed, gone), np.delete(self._count, gone)
        return _ints(np.append(full, changed >> 32)), _ints(np.append(np.zeros_like(full), changed & LOW))

    def counts_of(self, rows: Ints, fragments: Ints) -> Ints:
        wanted = (rows.astype(np.int64) << 32) | fragments
        place = np.searchsorted(self._packed, wanted)
        return _ints(np.where(np.append(self._packed, -1)[place] == wanted, np.append(self._count, 0)[place], 0))

    def owners(self, rows: Ints) -> tuple[Ints, Ints]:
        best, votes, background, total = self._strongest(rows)
        share = equations.instance_vector(np.where(votes > background, votes, background), np.maximum(total, 1))
        return _ints(np.where(votes > background, best, 0)), _ints(share)

    def votes(self) -> tuple[Longs, Ints, Ints, Ints]:
        return self._keys, _ints(self._packed >> 32), _ints(self._packed & LOW), _ints(self._count)

    def _entries(self, rows: Ints | Longs) -> tuple[Longs, Longs]:
        """All votes of the rows (EMPTY: none): the place in `rows` and in the sorted array."""
        first = np.where(rows < 0, 0, rows).astype(np.int64) << 32
        begin, end = np.searchsorted(self._packed, first), np.searchsorted(self._packed, first + (1 << 32))
        lengths = np.where(rows < 0, 0, end - begin)
        place = np.repeat(np.arange(len(rows)), lengths)
        return place, np.arange(len(place)) + np.repeat(begin - (np.cumsum(lengths) - lengths), lengths)

    def _strongest(self, rows: Ints | Longs) -> tuple[Longs, Longs, Longs, Longs]:
        """Of each row: the fragment with most votes, its votes, background's, and all."""
        place, entry = self._entries(rows)
        fragment, count = self._packed[entry] & LOW, self._count[entry]
        named = fragment > 0
        rank, background = np.zeros((2, len(rows)), np.int64)
        np.maximum.at(rank, place[named], (count[named] << 32) | (LOW - fragment[named]))
        background[place[~named]] = count[~named]
        total = np.bincount(place, count, len(rows)).astype(np.int64)
        return np.where(rank > 0, LOW - (rank & LOW), 0), rank >> 32, background, total


def with_numpy(mapper: Mapper) -> Mapper:
    """The same mapper over the plain kernels."""
    engine: Engine = mapper._engine
    engine._kernels = NumpyKernels()
    return mapper


def _ints(array: Longs) -> Ints:
    return array.astype(np.int32)
