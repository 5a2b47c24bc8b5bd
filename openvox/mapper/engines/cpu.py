"""The CPU engine: the voxels' votes and the kernels over them, compiled once and then cached.

An engine turns pixels into voxels (`observe`), reads the map where the frame looks (`look`), and counts votes (`vote`,
`move`). What it returns does not depend on the engine; how it keeps the votes is its own affair.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from openvox.core.mapper_parameters import MapperParameters
from openvox.core.types import Frame, Mask, Rig, VoxelChanges
from openvox.mapper import projection
from openvox.mapper.engines import paint, pixels, votes
from openvox.mapper.engines.pixels import EMPTY

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Number = TypeVar("Number", np.int32, np.int64)


@dataclass(frozen=True, eq=False)
class Region:
    """What one frame sees: voxels by key, and (voxel, mask) pairs; mask = number of masks means "under no mask"."""

    keys: Longs
    pair_voxel: Ints
    pair_mask: Ints
    masks: int
    voxels_of_mask: Longs
    """(masks,): |V_m|."""


@dataclass(eq=False)
class Look:
    """The map before the frame's votes, where the frame looks. `label` counts hidden evidence, `owner` does not."""

    rows: Ints
    owner: Ints
    label: Ints
    fragments: Ints
    """(columns,) ascending: fragments with votes in the region."""
    theta_sum: Longs
    """(masks + 1, columns): sum of theta in Q20."""
    overlap: Longs
    """(masks + 1, columns): C, voxels of the mask with that label; the last row is under no mask."""


class CpuEngine:
    """Votes of all voxels, and what can be done with them. One instance is one map."""

    name = "cpu"

    def __init__(self, parameters: MapperParameters) -> None:
        self._parameters = parameters
        self._max_mm = min(projection.MAX_MILLIMETRES, int(parameters.map.max_depth * 1000))
        self._rig: Rig | None = None
        self._room = 1 << 12
        self._keys = np.empty(1 << 11, np.int64)
        self._table = pixels.rebuilt(self._keys, 0, 1 << 12)
        self._heads = np.empty(1 << 11, np.int32)
        self._backgrounds = np.zeros(1 << 11, np.int32)
        self._fragment = np.empty(1 << 11, np.int32)
        self._count = np.empty(1 << 11, np.int32)
        self._next = np.empty(1 << 11, np.int32)
        self._state = np.array([0, 0, EMPTY], np.int64)
        self._number = np.full(1 << 10, EMPTY, np.int32)

    @property
    def voxels(self) -> int:
        """Voxels of the map."""
        return int(self._state[0])

    @property
    def _lists(self) -> tuple[Ints, Ints, Ints]:
        return self._fragment, self._count, self._next

    # ---- pixels to voxels -------------------------------------------------------------------------------------------

    def label_image(self, masks: Sequence[Mask | None], rig: Rig) -> tuple[Ints, list[tuple[int, ...]]]:
        """Masks painted into colour pixels, and the masks behind each label (0 = none, -1 = votes for nothing)."""
        if self._parameters.masks.one_vote:
            return self._smallest_on_top(masks, rig)
        image = np.zeros((rig.color.height, rig.color.width), np.int32)
        members: list[tuple[int, ...]] = [()]
        for m, mask in enumerate(masks):
            if mask is None:
                continue
            after = np.full(len(members), EMPTY, np.int64)
            paint.paint_combination(image, mask.bits, *mask.box, after, len(members))
            made = [int(before) for before in np.flatnonzero(after >= 0)]
            made.sort(key=lambda before: int(after[before]))
            members += [(*members[before], m) for before in made]
        return image, members

    def _smallest_on_top(self, masks: Sequence[Mask | None], rig: Rig) -> tuple[Ints, list[tuple[int, ...]]]:
        image = np.zeros((rig.color.height, rig.color.width), np.int32)
        areas = {m: mask.area for m, mask in enumerate(masks) if mask is not None}
        order = sorted(areas, key=lambda m: (areas[m], -m))  # the smallest first, so that it has the lowest label
        for label in range(len(order), 0, -1):
            mask = masks[order[label - 1]]
            assert mask is not None
            paint.paint(image, mask.bits, *mask.box, label)
        members: list[tuple[int, ...]] = [(), *((m,) for m in order)]
        if not self._parameters.masks.erosion:
            return image, members
        out = np.empty_like(image)
        paint.blur_borders(image, self._parameters.masks.erosion, np.empty(image.shape, np.uint8), out)
        return out, members

    def _set_rig(self, rig: Rig) -> None:
        if rig == self._rig:
            return
        self._rig = rig
        self._rays = projection.pixel_rays(rig.depth)
        self._skip = np.zeros((rig.depth.height, rig.depth.width), np.uint8)
        self._near = np.zeros_like(self._skip)
        look_up = projection.color_lookup(rig, self._rays)
        self._color = (
            look_up.rotation,
            look_up.translation,
            np.array([look_up.fx, look_up.fy, look_up.cx, look_up.cy], np.int64),
        )

    def observe(self, frame: Frame, image: Ints, members: list[tuple[int, ...]], masks: int) -> Region:
        """Depth pixels to voxels with their masks. Raises InputError where the pose leaves the map's range."""
        self._set_rig(frame.rig)
        p = self._parameters
        transform = projection.voxel_transform(frame.world_from_depth, p.map.voxel_size, self._rays, self._max_mm)
        depth = np.ascontiguousarray(frame.depth)
        margin = p.masks.step_margin if p.masks.one_vote else 0
        paint.depth_steps(depth, margin, self._near, self._skip)
        while True:
            keys, voxel, label, count, enough = pixels.count_pixels(
                depth, self._skip, image, self._max_mm, self._rays.x, self._rays.y, transform.a, transform.b,
                transform.c, frame.rig.registered, *self._color, self._room,
            )  # fmt: skip
            if enough:
                break
            self._room *= 2
        if p.masks.one_vote:
            most = pixels.majority(len(keys), voxel, label, count)
            mask = np.array([masks, *(group[0] for group in members[1:])], np.int32)[most]
            pair_voxel, pair_mask = np.arange(len(keys), dtype=np.int32), mask
            if not p.evolution.background:
                pair_voxel, pair_mask = pair_voxel[mask < masks], mask[mask < masks]
        else:
            pair_voxel, pair_mask = _expanded(voxel, label, members, masks, p.evolution.background)
        return Region(keys, pair_voxel, pair_mask, masks, np.bincount(pair_mask, minlength=masks + 1)[:masks])

    # ---- reading ----------------------------------------------------------------------------------------------------

    def look(self, region: Region, fragments: int) -> Look:
        """The map where the frame looks. fragments: highest fragment id so far."""
        hidden = self._parameters.association.hidden_evidence if self._parameters.evolution.background else 1
        rows, owner, label = votes.look_up(
            region.keys, self._table, self._keys, self._heads, self._backgrounds, *self._lists, hidden
        )
        self._number = _grown(self._number, fragments + 1, EMPTY)
        found = np.empty(fragments + 1, np.int32)
        n = votes.fragments_there(rows, self._heads, self._fragment, self._next, self._number, found)
        there = np.sort(found[:n])
        self._number[there] = np.arange(n, dtype=np.int32)
        theta_sum, overlap = votes.shares(
            region.pair_voxel, region.pair_mask, rows, label, region.masks, n, self._number,
            self._heads, self._backgrounds, *self._lists,
        )  # fmt: skip
        self._number[there] = EMPTY
        return Look(rows, owner, label, there, theta_sum, overlap)

    # ---- writing ----------------------------------------------------------------------------------------------------

    def move(self, region: Region, look: Look, mask: int, source: int, target: int) -> tuple[Ints, int]:
        """Rename the votes for `source` under a mask to `target`; returns the rows that changed and the votes moved."""
        under = look.rows[region.pair_voxel[region.pair_mask == mask]]
        under = np.sort(under[under != EMPTY])
        before = votes.counts_of(under, np.full_like(under, source), self._heads, self._backgrounds, *self._lists)
        rows = under[before > 0]
        votes.move_votes(rows, source, target, self._heads, self._fragment, self._next)
        return rows, int(before.sum())

    def targets(
        self, region: Region, look: Look, held: NDArray[np.bool_], main: Ints, undecided: NDArray[np.bool_]
    ) -> Ints:
        """The fragment that each (voxel, mask) pair votes for: > 0, 0 = background, EMPTY = nothing.

        held (masks, columns of look): the mask holds the fragment; main (masks,): the fragment of what nobody holds, or
        EMPTY for no vote; undecided (masks,): what nobody holds votes for nothing."""
        self._number = _grown(self._number, int(look.fragments[-1]) + 1 if len(look.fragments) else 1, EMPTY)
        self._number[look.fragments] = np.arange(len(look.fragments), dtype=np.int32)
        target: Ints = votes.choose_targets(
            region.pair_voxel, region.pair_mask, look.rows, look.label, region.masks, self._number, held, main,
            undecided, held.any(0), self._parameters.evolution.voxel_votes,
            self._heads, *self._lists,
        )  # fmt: skip
        self._number[look.fragments] = EMPTY
        return target

    def vote(
        self, region: Region, look: Look, target: Ints, amount: Ints, moved: Sequence[tuple[Ints, int, int]]
    ) -> tuple[VoxelChanges, Ints]:
        """Count the frame's votes; `moved` lists earlier moves (rows, source, target) of this frame.

        Returns the changes, and the owner after the frame of every voxel of the region."""
        casts = target != EMPTY
        voxel, target, amount = region.pair_voxel[casts], target[casts], amount[casts]
        first_new, new_keys = self._add_rows(region, look, voxel)
        rows = look.rows[voxel]
        self._make_room(slots=len(rows))
        votes.add_votes(rows, target, amount, self._heads, self._backgrounds, *self._lists, self._state)
        changed = [(rows, target)]
        for moved_rows, source, new in moved:
            changed += [(moved_rows, np.full_like(moved_rows, source)), (moved_rows, np.full_like(moved_rows, new))]
        touched = _distinct(np.concatenate([part[0] for part in changed]))
        if self._parameters.evolution.background and self._parameters.evolution.halving:
            changed.append(self._halve(touched))
        row = np.concatenate([part[0] for part in changed]).astype(np.int64)
        what = np.concatenate([part[1] for part in changed]).astype(np.int64)
        packed = _distinct((row << 32) | what)
        row32, what32 = (packed >> 32).astype(np.int32), (packed & 0xFFFFFFFF).astype(np.int32)
        counts = votes.counts_of(row32, what32, self._heads, self._backgrounds, *self._lists)
        owner, share = votes.owners(touched, self._heads, self._backgrounds, *self._lists)
        after, _ = votes.owners(look.rows, self._heads, self._backgrounds, *self._lists)
        index = projection.voxel_index(new_keys)
        return VoxelChanges(first_new, index, row32, what32, counts, touched, owner, share), after

    def _add_rows(self, region: Region, look: Look, voxel: Ints) -> tuple[int, Longs]:
        """Rows for voxels that get their first vote, numbered by key; look.rows learns them."""
        first_new = self.voxels
        new = np.unique(voxel[look.rows[voxel] == EMPTY])
        new = new[np.argsort(region.keys[new])]
        keys: Longs = region.keys[new]
        total = first_new + len(new)
        if total > len(self._keys):
            self._keys = _grown(self._keys, total, 0)
            self._heads = _grown(self._heads, total, EMPTY)
            self._backgrounds = _grown(self._backgrounds, total, 0)
        self._keys[first_new:total] = keys
        self._heads[first_new:total] = EMPTY
        self._backgrounds[first_new:total] = 0
        self._state[0] = total
        if 5 * total > 3 * len(self._table):
            size = 2 * len(self._table)
            while 5 * total > 3 * size:
                size *= 2
            self._table = pixels.rebuilt(self._keys, total, size)
        else:
            pixels.insert_range(self._table, self._keys, first_new, total)
        look.rows[new] = np.arange(first_new, total, dtype=np.int32)
        return first_new, keys

    def _make_room(self, slots: int) -> None:
        total = int(self._state[1]) + slots
        self._fragment = _grown(self._fragment, total, 0)
        self._count = _grown(self._count, total, 0)
        self._next = _grown(self._next, total, EMPTY)

    def _halve(self, rows: Ints) -> tuple[Ints, Ints]:
        units = self._parameters.evolution.halving * 2
        room = len(rows) + int(self._state[1])
        row, fragment = np.empty(room, np.int32), np.empty(room, np.int32)
        n = votes.halve(rows, units, self._heads, self._backgrounds, *self._lists, self._state, row, fragment)
        return row[:n], fragment[:n]

    def votes(self) -> tuple[Longs, Ints, Ints, Ints]:
        """Keys of all voxels by number, and all votes: voxel number, fragment (0 = background), count; unordered."""
        rows, slots = int(self._state[0]), int(self._state[1])
        row, fragment, count = votes.all_votes(rows, self._heads, self._backgrounds, *self._lists, slots)
        return self._keys[:rows].copy(), row, fragment, count

    def whole(self) -> VoxelChanges:
        """All voxels and votes, as one step would tell them that made them all."""
        keys, row, fragment, count = self.votes()
        order = np.lexsort((fragment, row))
        rows = np.arange(len(keys), dtype=np.int32)
        owner, share = votes.owners(rows, self._heads, self._backgrounds, *self._lists)
        return VoxelChanges(
            0, projection.voxel_index(keys), row[order], fragment[order], count[order], rows, owner, share
        )

    def restore(self, keys: Longs, row: Ints, fragment: Ints, count: Ints) -> None:
        """Fill an empty engine with voxels by number and their votes, as `votes` gives them."""
        n, size = len(keys), len(self._table)
        while 5 * n > 3 * size:
            size *= 2
        self._keys = _grown(keys.astype(np.int64), 1 << 11, 0)
        self._table = pixels.rebuilt(self._keys, n, size)
        self._heads = np.full(len(self._keys), EMPTY, np.int32)
        self._backgrounds = np.zeros(len(self._keys), np.int32)
        self._state[0] = n
        self._make_room(slots=len(row))
        votes.add_votes(row, fragment, count, self._heads, self._backgrounds, *self._lists, self._state)


def common_pixels(a: Mask, b: Mask) -> int:
    """Pixels that two masks share."""
    return int(paint.common_pixels(a.bits, a.box, b.bits, b.box))


def _grown(array: NDArray[Number], size: int, fill: int) -> NDArray[Number]:
    """The array with room for `size`, half as much again at least when it grows."""
    if size <= len(array):
        return array
    out = np.full(max(size, len(array) + len(array) // 2), fill, array.dtype)
    out[: len(array)] = array
    return out


def _distinct(array: NDArray[Number]) -> NDArray[Number]:
    """Ascending values, each once; on short arrays quicker than numpy.unique."""
    ascending = np.sort(array)
    if len(ascending) < 2:
        return ascending
    first = np.ones(len(ascending), np.bool_)
    np.not_equal(ascending[1:], ascending[:-1], out=first[1:])
    return ascending[first]


def _expanded(
    voxel: Ints, label: Ints, members: list[tuple[int, ...]], masks: int, background: bool
) -> tuple[Ints, Ints]:
    """(voxel, combination) entries to distinct (voxel, mask) pairs; voxels of no mask at all get mask = masks."""
    lengths = np.array([len(group) for group in members], np.int64)
    flat = np.array([m for group in members for m in group], np.int64)
    offsets = np.concatenate([[0], np.cumsum(lengths)])
    repeat = lengths[label]
    owner = np.repeat(voxel.astype(np.int64), repeat)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(repeat) - repeat, repeat)
    mask = flat[np.repeat(offsets[label], repeat) + within] if len(flat) else np.zeros(0, np.int64)
    packed = np.unique((owner << 32) | mask)
    if background:
        bare = np.setdiff1d(voxel.astype(np.int64), owner)
        packed = np.sort(np.concatenate([packed, (bare << 32) | masks]))
    return (packed >> 32).astype(np.int32), (packed & 0xFFFFFFFF).astype(np.int32)
