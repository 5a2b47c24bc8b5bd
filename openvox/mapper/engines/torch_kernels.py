"""The kernels of the torch engine: the same integers on a CPU or a GPU, each step for all voxels at once.

Everything is int64, sums commute and maxima carry the id, so that the order in which threads write decides nothing.
Where a table or a list is written at once by many, somebody wins and the others try again: rows and slots may lie
elsewhere than in another run, and nothing that is returned depends on where they lie.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from openvox.core.errors import InputError
from openvox.core.voxels import RANGE
from openvox.mapper import equations
from openvox.mapper.engines.engine import Bools, Ints, Longs, Look, Region, View
from openvox.mapper.engines.pixels import EMPTY

if TYPE_CHECKING:
    from torch import Tensor

try:
    import torch
except ImportError:
    raise InputError(
        'engine torch needs torch, which is not installed; pip install "openvox[torch]", or choose --engine cpu'
    ) from None

FIRST = 1 << 11
LOW = 0xFFFFFFFF


class TorchKernels:
    """A hash table of rows over keys, and a linked list of votes a row, as tensors on the first GPU if there is one."""

    def __init__(self, slots: int) -> None:
        self.voxels = 0
        self._limit = slots
        self._device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        torch.set_num_threads(1)  # the steps are short: threads would wait for each other longer than they work
        self._keys = self._full(FIRST, 0)
        self._table = self._full(2 * FIRST, EMPTY)
        self._heads, self._backgrounds = self._full(FIRST, EMPTY), self._full(FIRST, 0)
        self._fragment, self._count, self._next = self._full(FIRST, 0), self._full(FIRST, 0), self._full(FIRST, EMPTY)
        self._slots = 0
        self._free = self._full(0, 0)

    @property
    def bytes(self) -> int:
        """Memory of all tensors."""
        kept = (self._keys, self._table, self._heads, self._backgrounds, self._fragment, self._count, self._next)
        return sum(tensor.numel() * tensor.element_size() for tensor in (*kept, self._free))

    # ---- pixels to voxels -------------------------------------------------------------------------------------------

    def count_pixels(self, view: View, labels: Ints) -> tuple[Longs, Ints, Ints, Ints]:
        """See `Kernels`."""
        z = self._from(view.depth)
        x, y = self._from(view.rays.x)[None, :], self._from(view.rays.y)[:, None]
        use = (z > 0) & (z <= view.max_mm) & (self._from(view.skip) == 0)
        label = self._from(labels) if view.color is None else self._label_through_color(view, z, x, y, labels)
        use &= label >= 0
        a, b, c = view.transform.a.tolist(), view.transform.b.tolist(), view.transform.c.tolist()
        key = torch.zeros_like(z)
        for axis in range(3):
            place = ((z * (a[axis][0] * x + a[axis][1] * y + (a[axis][2] << 18)) + c[axis]) >> 46) + b[axis] + RANGE
            key = (key << 21) | place
        keys, voxel = torch.unique(key[use], return_inverse=True)
        labels_there = max(1, int(label.max()) + 1)
        packed, pixels = torch.unique(voxel * labels_there + label[use], return_counts=True)
        return _longs(keys), _ints(packed // labels_there), _ints(packed % labels_there), _ints(pixels)

    def _label_through_color(self, view: View, z: Tensor, x: Tensor, y: Tensor, labels: Ints) -> Tensor:
        """Label of the nearest colour pixel of each depth pixel, EMPTY out of the picture."""
        color = view.color
        assert color is not None
        rotation, moved = color.rotation.tolist(), color.translation.tolist()
        px, py, pz = (
            (z * (rotation[i][0] * x + rotation[i][1] * y + (rotation[i][2] << 18)) + moved[i]) >> 28 for i in range(3)
        )
        den = pz.clamp(min=1) << 16
        u = (2 * (color.fx * px + color.cx * pz) + den) // (2 * den)
        v = (2 * (color.fy * py + color.cy * pz) + den) // (2 * den)
        height, width = labels.shape
        inside = (pz > 0) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
        flat = self._from(labels).reshape(-1)
        return torch.where(inside, flat[torch.where(inside, v * width + u, 0)], EMPTY)

    # ---- sums of shares ---------------------------------------------------------------------------------------------

    def look_up(self, keys: Longs, hidden_evidence: int) -> tuple[Ints, Ints, Ints]:
        """See `Kernels`."""
        rows = self._find(self._from(keys))
        best, votes, background, _ = self._strongest(rows)
        background = background if self._limit == 0 else torch.zeros_like(background)
        owner = torch.where(votes > background, best, 0)
        return _ints(rows), _ints(owner), _ints(torch.where(hidden_evidence * votes > background, best, 0))

    def shares(
        self, rows: Ints, label: Ints, pair_voxel: Ints, pair_mask: Ints, masks: int, highest: int
    ) -> tuple[Ints, Longs, Longs]:
        """See `Kernels`."""
        voxel, mask, row = self._from(pair_voxel), self._from(pair_mask), self._from(rows)
        there = torch.unique(self._fragment[self._entries(row)[1]])
        column = self._full(highest + 1, 0)
        column[there] = torch.arange(len(there), device=self._device)
        own = self._from(label)[voxel]
        overlap, theta_sum = (self._full((masks + 1) * len(there), 0) for _ in range(2))
        labelled = own > 0
        one = torch.ones_like(own)
        overlap.index_add_(0, (mask * len(there) + column[own])[labelled], one[labelled])
        under = mask < masks
        pair, slot = self._entries(row[voxel[under]])
        total = self._strongest(row)[3][voxel[under]]
        theta = equations.instance_vector(self._count[slot], total[pair])
        theta_sum.index_add_(0, mask[under][pair] * len(there) + column[self._fragment[slot]], theta)
        shape = (masks + 1, len(there))
        return _ints(there), _longs(theta_sum.reshape(shape)), _longs(overlap.reshape(shape))

    def targets(self, region: Region, look: Look, held: Bools, main: Ints, undecided: Bools, voxel_votes: bool) -> Ints:
        """See `Kernels`."""
        voxel, mask = self._from(region.pair_voxel), self._from(region.pair_mask)
        own = self._from(look.label)[voxel]
        columns = len(look.fragments)
        column = self._full(int(look.fragments[-1]) + 1 if columns else 1, columns)
        column[self._from(look.fragments)] = torch.arange(columns, device=self._device)
        holds = torch.zeros((region.masks + 1, columns + 1), dtype=torch.bool, device=self._device)
        holds[:-1, :-1] = torch.from_numpy(held)
        under = mask < region.masks
        founder = torch.cat([self._from(main), self._full(1, EMPTY)])
        if voxel_votes:
            pair, slot = self._entries(torch.where(under, self._from(look.rows)[voxel], EMPTY))
            known = holds[mask[pair], column[self._fragment[slot]]]
            rank = self._full(len(voxel), 0)
            rank.scatter_reduce_(0, pair[known], self._rank(slot[known]), "amax")
            undecided_here = torch.cat([torch.from_numpy(undecided).to(self._device), self._full(1, 0) > 0])[mask]
            target = torch.where(undecided_here, EMPTY, founder[mask])
            target = torch.where(rank > 0, LOW - (rank & LOW), target)
            target = torch.where(holds[mask, column[own]] & (own > 0), own, target)
        else:
            target = founder[mask]
        left_out = (own == 0) | holds.any(0)[column[own]]
        return _ints(torch.where(under, target, torch.where(left_out, 0, EMPTY)))

    # ---- adding votes -----------------------------------------------------------------------------------------------

    def add_rows(self, keys: Longs) -> None:
        """See `Kernels`."""
        before, total = self.voxels, self.voxels + len(keys)
        self._keys = self._grown(self._keys, total, 0)
        self._heads = self._grown(self._heads, total, EMPTY)
        self._backgrounds = self._grown(self._backgrounds, total, 0)
        self._keys[before:total] = self._from(keys)
        self.voxels = total
        size = len(self._table)
        while 5 * total > 3 * size:
            size *= 2
        if size > len(self._table):
            self._table, before = self._full(size, EMPTY), 0
        self._insert(torch.arange(before, total, device=self._device))

    def add_votes(self, rows: Ints, fragments: Ints, amounts: Ints) -> None:
        """See `Kernels`."""
        row, fragment, amount = self._from(rows), self._from(fragments), self._from(amounts)
        if self._limit:
            fragment = self._within_limit(row, fragment)
            fragments[:] = _ints(fragment)
        bare = fragment == 0
        self._backgrounds.index_add_(0, row[bare], amount[bare])
        packed, which = torch.unique((row[~bare] << 32) | fragment[~bare], return_inverse=True)
        summed = self._full(len(packed), 0).index_add_(0, which, amount[~bare])
        row, fragment = packed >> 32, packed & LOW
        pair, slot = self._entries(row)
        same = self._fragment[slot] == fragment[pair]
        place = self._full(len(packed), EMPTY)
        place[pair[same]] = slot[same]
        new = place == EMPTY
        place[new] = self._new_slots(int(new.sum()))
        self._fragment[place[new]], self._count[place[new]] = fragment[new], 0
        self._chain(row[new], place[new], self._heads[row[new]])
        self._count[place] = equations.count_votes(self._count[place], summed)

    def _within_limit(self, row: Tensor, fragment: Tensor) -> Tensor:
        """The fragments of votes in distinct rows, 0 where a full list does not hold them."""
        pair, slot = self._entries(row)
        length = self._full(len(row), 0).index_add_(0, pair, torch.ones_like(pair))
        known = self._full(len(row), 0).index_add_(0, pair, (self._fragment[slot] == fragment[pair]).to(torch.int64))
        return torch.where((known == 0) & (length >= self._limit), 0, fragment)

    def move_votes(self, rows: Ints, source: int, target: int) -> None:
        """See `Kernels`."""
        _, slot = self._entries(self._from(rows))
        self._fragment[slot[self._fragment[slot] == source]] = target

    def halve(self, rows: Ints, limit: int) -> tuple[Ints, Ints]:
        """See `Kernels`."""
        row = self._from(rows)
        row = row[self._strongest(row)[3] > limit]
        pair, slot = self._entries(row)
        changed = torch.cat([row, row[pair]]), torch.cat([torch.zeros_like(row), self._fragment[slot]])
        self._backgrounds[row] >>= 1
        self._count[slot] >>= 1
        left = self._count[slot] > 0
        self._free = torch.cat([self._free, slot[~left]])
        by_row = torch.sort(pair[left], stable=True)
        self._heads[row] = EMPTY
        self._chain(row[by_row[0]], slot[left][by_row[1]], self._full(int(left.sum()), EMPTY))
        return _ints(changed[0]), _ints(changed[1])

    def counts_of(self, rows: Ints, fragments: Ints) -> Ints:
        """See `Kernels`."""
        row, fragment = self._from(rows), self._from(fragments)
        out = torch.where(fragment == 0, self._backgrounds[row], 0)
        pair, slot = self._entries(row)
        same = self._fragment[slot] == fragment[pair]
        out[pair[same]] = self._count[slot[same]]
        return _ints(out)

    def owners(self, rows: Ints) -> tuple[Ints, Ints]:
        """See `Kernels`."""
        best, votes, background, total = self._strongest(self._from(rows))
        won = votes > (background if self._limit == 0 else 0)
        share = equations.instance_vector(torch.where(won, votes, background), total.clamp(min=1))
        return _ints(torch.where(won, best, 0)), _ints(share)

    def votes(self) -> tuple[Longs, Ints, Ints, Ints]:
        """See `Kernels`."""
        rows = torch.arange(self.voxels, device=self._device)
        bare = rows[self._backgrounds[: self.voxels] > 0]
        pair, slot = self._entries(rows)
        fragment = torch.cat([torch.zeros_like(bare), self._fragment[slot]])
        count = torch.cat([self._backgrounds[bare], self._count[slot]])
        return _longs(self._keys[: self.voxels]), _ints(torch.cat([bare, pair])), _ints(fragment), _ints(count)

    # ---- lists and tables -------------------------------------------------------------------------------------------

    def _entries(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """All votes in the lists of the rows (EMPTY: none): the place in `rows` and the slot of each."""
        place, slot = torch.arange(len(rows), device=self._device), self._heads[rows.clamp(min=0)]
        slot = torch.where(rows < 0, EMPTY, slot)
        places, slots = [place[:0]], [slot[:0]]
        while True:
            there = slot >= 0
            place, slot = place[there], slot[there]
            if not len(slot):
                return torch.cat(places), torch.cat(slots)
            places.append(place)
            slots.append(slot)
            slot = self._next[slot]

    def _rank(self, slot: Tensor) -> Tensor:
        """More votes rank higher, then the lower id."""
        return (self._count[slot] << 32) | (LOW - self._fragment[slot])

    def _strongest(self, rows: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of each row: the fragment with most votes, its votes, background's, and all; 0 where EMPTY."""
        place, slot = self._entries(rows)
        rank = self._full(len(rows), 0).scatter_reduce_(0, place, self._rank(slot), "amax")
        background = torch.where(rows < 0, 0, self._backgrounds[rows.clamp(min=0)])
        total = background.index_add(0, place, self._count[slot])
        return torch.where(rank > 0, LOW - (rank & LOW), 0), rank >> 32, background, total

    def _chain(self, rows: Tensor, slots: Tensor, rest: Tensor) -> None:
        """Put slots, ordered by row, before the `rest` of their rows' lists."""
        if not len(rows):
            return
        first = torch.ones_like(rows, dtype=torch.bool)
        first[1:] = rows[1:] != rows[:-1]
        self._next[slots] = torch.where(first, rest, torch.roll(slots, 1))
        last = torch.roll(first, -1)
        self._heads[rows[last]] = slots[last]

    def _new_slots(self, n: int) -> Tensor:
        freed, self._free = self._free[:n], self._free[n:]
        fresh = torch.arange(self._slots, self._slots + n - len(freed), device=self._device)
        self._slots += len(fresh)
        self._fragment = self._grown(self._fragment, self._slots, 0)
        self._count = self._grown(self._count, self._slots, 0)
        self._next = self._grown(self._next, self._slots, EMPTY)
        return torch.cat([freed, fresh])

    def _first_slot(self, keys: Tensor) -> Tensor:
        """Where the search for a key begins: its bits stirred, products wrapping around 64 bits."""
        x = keys * -0x61C8864680B583EB
        x = (x ^ (x >> 29)) * -0x40A7B892E31B1A47
        return (x ^ (x >> 32)) & (len(self._table) - 1)

    def _find(self, keys: Tensor) -> Tensor:
        """Row of each key, EMPTY if the map has none."""
        out, slot = self._full(len(keys), EMPTY), self._first_slot(keys)
        waiting = torch.arange(len(keys), device=self._device)
        while len(waiting):
            row = self._table[slot]
            hit = (row >= 0) & (self._keys[row.clamp(min=0)] == keys[waiting])
            out[waiting[hit]] = row[hit]
            on = (row >= 0) & ~hit
            waiting, slot = waiting[on], (slot[on] + 1) & (len(self._table) - 1)
        return out

    def _insert(self, rows: Tensor) -> None:
        """Enter rows whose keys the table does not hold yet; of several that want a place, one gets it."""
        slot = self._first_slot(self._keys[rows])
        while len(rows):
            free = self._table[slot] < 0
            self._table[slot[free]] = rows[free]
            on = self._table[slot] != rows
            rows, slot = rows[on], (slot[on] + 1) & (len(self._table) - 1)

    def _full(self, size: int, value: int) -> Tensor:
        return torch.full((size,), value, dtype=torch.int64, device=self._device)

    def _from(self, array: np.ndarray[tuple[int, ...], np.dtype[np.generic]]) -> Tensor:
        return torch.from_numpy(array.astype(np.int64)).to(self._device)

    def _grown(self, tensor: Tensor, size: int, fill: int) -> Tensor:
        if size <= len(tensor):
            return tensor
        return torch.cat([tensor, self._full(max(size - len(tensor), len(tensor) // 4), fill)])


def _ints(tensor: Tensor) -> Ints:
    out: Ints = tensor.to(torch.int32).cpu().numpy()
    return out


def _longs(tensor: Tensor) -> Longs:
    out: Longs = tensor.cpu().numpy().copy()
    return out
