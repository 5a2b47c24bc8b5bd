"""From votes to what each voxel shows: kernel counting, then rounds at the borders of things and background."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from openvox.core.voxels import rows_of, voxel_index, voxel_key

Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
Counted = tuple[Ints, Ints, Longs]
"""Voxel (or its place among some), instance and votes, entry by entry."""
CHUNK = 1 << 13
"""Voxels that are smoothed at a time."""
FACES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))


def face_neighbours(keys: Longs) -> Ints:
    """(6, voxels): the row beyond each face of each voxel, -1 where the map has none. keys ascending."""
    out = np.empty((len(FACES), len(keys)), np.int32)
    index = voxel_index(keys).astype(np.int64)
    for rows, face in zip(out, FACES, strict=True):
        rows[:] = rows_of(keys, voxel_key(index + np.array(face)))
    return out


@dataclass(frozen=True, eq=False)
class Tally:
    """Votes of all voxels by instance, 0 = background: sorted by voxel, then instance."""

    row: Ints
    instance: Ints
    count: Longs
    total: Longs
    """(voxels,): all votes of each voxel, those that name nobody too."""

    @cached_property
    def offset(self) -> Longs:
        """(voxels + 1,): where the votes of each voxel begin."""
        return np.searchsorted(self.row, np.arange(len(self.total) + 1))

    def own(self, shown: Longs) -> Longs:
        """(voxels,): votes of each voxel for what it shows."""
        own = np.zeros(len(shown), np.int64)
        mine = self.instance == shown[self.row]
        own[self.row[mine]] = self.count[mine]
        return own

    def of(self, rows: Longs | Ints, factor: int) -> Counted:
        """The votes of the voxels `rows` (-1 = none) times a factor."""
        known = np.maximum(rows, 0)
        first = self.offset[known]
        lengths = np.where(rows >= 0, self.offset[known + 1] - first, 0)
        place = np.repeat(np.arange(len(rows)), lengths)
        vote = np.arange(len(place)) + np.repeat(first - (np.cumsum(lengths) - lengths), lengths)
        return place.astype(np.int32), self.instance[vote], self.count[vote] * factor


def sum_by_instance(row: Ints, instance: Ints, count: Ints | Longs) -> Counted:
    """Votes summed per (voxel, instance), by voxel, then instance."""
    packed = (row.astype(np.int64) << 32) | instance
    order = np.argsort(packed, kind="stable")  # quick: voxels are mostly in order already
    packed = packed[order]
    first = np.flatnonzero(np.diff(packed, prepend=-1))
    summed = np.add.reduceat(count[order], first, dtype=np.int64) if len(first) else count.astype(np.int64)
    packed = packed[first]
    return (packed >> 32).astype(np.int32), (packed & 0xFFFFFFFF).astype(np.int32), summed


def shown_instances(tally: Tally, beside: Ints, weight: int, rounds: int) -> Longs:
    """(voxels,): the instance that each voxel shows, 0 = none. beside: see face_neighbours.

    Kernel counting: the strongest of weight x own counts + those of the six face neighbours; weight 0 stands for own
    counts alone. Then rounds at the borders of things and background, with a weight of at least 1."""
    shown = np.zeros(len(tally.total), np.int64)
    for rows in _some(np.arange(len(shown))):
        counted = [tally.of(rows, max(1, weight))]
        counted += [tally.of(face[rows], 1) for face in (beside if weight else ())]
        shown[rows] = _strongest(counted, len(rows))
    for _ in range(rounds):
        shown = _settled(shown, tally, beside, max(1, weight))
    return shown


def _settled(shown: Longs, tally: Tally, beside: Ints, weight: int) -> Longs:
    """One round at the borders of things and background, all voxels at once (iterated conditional modes, Besag 1986).

    A voxel there decides again, on weight x its own counts + all votes of each face neighbour, at most weight x its
    own, for what that neighbour shows: what was seen seldom follows what was seen often. Between two things neighbours
    are not heard, as a small one beside a large one would be lost."""
    after = shown.copy()
    for rows in _some(_at_border(shown, beside)):
        counted = [tally.of(rows, weight), *(_heard(rows, face[rows], shown, tally.total, weight) for face in beside)]
        after[rows] = _strongest(counted, len(rows))
    return after


def _some(rows: Longs) -> Iterator[Longs]:
    """CHUNK rows at a time: seven times all votes would take much memory."""
    for begin in range(0, len(rows), CHUNK):
        yield rows[begin : begin + CHUNK]


def _at_border(shown: Longs, beside: Ints) -> Longs:
    """Rows of things with a face neighbour that shows none, and of those neighbours."""
    border = np.zeros(len(shown), np.bool_)
    for other in beside:
        border |= (other >= 0) & ((shown > 0) != (shown[other] > 0))
    return np.flatnonzero(border)


def _heard(rows: Longs, other: Ints, shown: Longs, total: Longs, weight: int) -> Counted:
    """What one face neighbour of each of the rows says: place in rows, what it shows, with how many votes."""
    here, there = shown[rows], shown[other]
    place = np.flatnonzero((other >= 0) & ((here == there) | (here == 0) | (there == 0)))
    votes = np.minimum(total[other[place]], weight * total[rows[place]])
    return place.astype(np.int32), there[place].astype(np.int32), votes


def _strongest(counted: Sequence[Counted], voxels: int) -> Longs:
    """The instance with most votes in each voxel if it beats background strictly, the lowest id on a tie; else 0."""
    row, instance, count = sum_by_instance(*(np.concatenate([part[i] for part in counted]) for i in range(3)))
    rank = (count << 32) | (0xFFFFFFFF - instance.astype(np.int64))
    best, background = np.zeros(voxels, np.int64), np.zeros(voxels, np.int64)
    ids = instance > 0
    np.maximum.at(best, row[ids], rank[ids])
    background[row[~ids]] = count[~ids]
    return np.where(best >> 32 > background, 0xFFFFFFFF - (best & 0xFFFFFFFF), 0)
