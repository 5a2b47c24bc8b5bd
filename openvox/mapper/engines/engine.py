"""The engine: from a frame's pixels to changed votes. What every engine does alike is written here, once.

The three kernels behind it are an engine's own: pixels to voxels (`count_pixels`), sums of shares (`look_up`, `shares`,
`targets`) and adding votes (`add_votes`, with what moves, halves and reads them). What they return does not depend on
the engine, nor on the place of a voxel in its tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from openvox.core.mapper_parameters import MapperParameters
from openvox.core.types import DepthImage, Frame, Mask, Rig, VoxelChanges
from openvox.core.voxels import voxel_index
from openvox.mapper import projection
from openvox.mapper.engines import labels, paint, pixels
from openvox.mapper.engines.labels import read_only
from openvox.mapper.engines.outliers import inliers
from openvox.mapper.engines.pixels import EMPTY

Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Bools = NDArray[np.bool_]
Number = TypeVar("Number", np.int32, np.int64)
NAMELESS = -1
"""The fragment of votes for ids beyond the limit."""
MOST_WORTH = 4
"""What a vote counts at most: nearer than a quarter of `evolution.near` nothing is seen finer."""


@dataclass(frozen=True, eq=False)
class Region:
    """What one frame sees: voxels by key, and (voxel, mask) pairs; mask = number of masks means "under no mask"."""

    keys: Longs
    pair_voxel: Ints
    pair_mask: Ints
    masks: int
    voxels_of_mask: Longs
    """(masks,): |V_m|."""
    worth: Ints
    """(voxels,): what a vote counts, by distance."""

    def under(self, mask: int) -> Region:
        """What lies under one mask alone, or under none."""
        voxel = self.pair_voxel[self.pair_mask == mask]
        alone = np.zeros_like(self.voxels_of_mask)
        if mask < self.masks:
            alone[mask] = len(voxel)
        pairs = np.arange(len(voxel), dtype=np.int32), np.full(len(voxel), mask, np.int32)
        return Region(self.keys[voxel], *pairs, self.masks, alone, self.worth[voxel])


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


@dataclass(frozen=True, eq=False)
class View:
    """A frame's geometry in integers, see mapper.projection."""

    depth: DepthImage
    skip: NDArray[np.uint8]
    """1 = leave out."""
    max_mm: int
    rays: projection.Rays
    transform: projection.VoxelTransform
    color: projection.ColorLookup | None
    """None if depth is registered to colour."""


class Kernels(Protocol):
    """What an engine brings: the votes of all voxels, and three kernels over them. Rows are voxels by number.

    A voxel has a list of ids with votes, and one count that is no id's: background's, or with a limit of ids (`slots`)
    that of all ids beyond it, which has a part in the total but wins over nobody."""

    voxels: int

    @property
    def bytes(self) -> int:
        """Memory of the map."""

    def count_pixels(self, view: View, labels: Ints) -> tuple[Longs, Ints, Ints, Ints]:
        """Keys of the voxels in view, in any order, and entries: voxel (its place in keys), label, pixels."""

    def look_up(self, keys: Longs, hidden_evidence: int) -> tuple[Ints, Ints, Ints]:
        """Row (EMPTY if new), owner and label of each key."""

    def shares(
        self, rows: Ints, label: Ints, pair_voxel: Ints, pair_mask: Ints, masks: int, highest: int
    ) -> tuple[Ints, Longs, Longs]:
        """Fragments with votes in the rows, ascending, and theta_sum and overlap of `Look`. highest: fragment id."""

    def targets(self, region: Region, look: Look, held: Bools, main: Ints, undecided: Bools, voxel_votes: bool) -> Ints:
        """The fragment that each pair votes for: > 0, 0 = background, EMPTY = nothing; see `Engine.vote`."""

    def add_rows(self, keys: Longs) -> None:
        """New voxels, numbered on in the order of their keys."""

    def add_votes(self, rows: Ints, fragments: Ints, amounts: Ints) -> None:
        """Count votes; fragment 0 = no id. What finds no slot becomes 0 in `fragments`; then rows must be distinct."""

    def move_votes(self, rows: Ints, source: int, target: int) -> None:
        """Rename the votes for `source` in distinct rows."""

    def halve(self, rows: Ints, limit: int) -> tuple[Ints, Ints]:
        """Halve, rounding down, the counts of rows that hold more than `limit`: (row, fragment) of what changed."""

    def counts_of(self, rows: Ints, fragments: Ints) -> Ints:
        """Votes of each (row, fragment)."""

    def owners(self, rows: Ints) -> tuple[Ints, Ints]:
        """Owner of each row and its share of all votes in Q20 (background's if there is no owner); 0 where EMPTY."""

    def votes(self) -> tuple[Longs, Ints, Ints, Ints]:
        """Keys by row, and all votes: row, fragment (0 = background), count; unordered."""


def kernels(name: str, slots: int) -> Kernels:
    """The kernels of engine `name`, over an empty map; slots: ids that a voxel may hold, 0 = no limit.

    Raises InputError where the engine cannot run here."""
    if name == "torch":
        from openvox.mapper.engines.torch_kernels import TorchKernels

        return TorchKernels(slots)
    from openvox.mapper.engines.cpu import CpuKernels

    return CpuKernels(slots)


class Engine:
    """Votes of all voxels, and what a frame does with them. One instance is one map."""

    def __init__(self, parameters: MapperParameters, name: str = "cpu") -> None:
        self.name = name
        self._parameters = parameters
        one_by_one = parameters.association.one_by_one
        self._slots = parameters.association.slots if one_by_one else 0
        self._kernels = kernels(name, self._slots)
        self._max_mm = min(projection.MAX_MILLIMETRES, int(parameters.map.max_depth * 1000))
        self._hidden = parameters.association.hidden_evidence if parameters.evolution.background else 1
        self._rig: Rig | None = None
        self._bare = np.zeros(1, np.int32)  # with evolution.veto: how often each voxel was seen under no mask
        self._new_keys: list[Longs] = []
        self._told = 0
        self._changed: list[tuple[Ints, Ints]] = []

    @property
    def voxels(self) -> int:
        """Voxels of the map."""
        return self._kernels.voxels

    @property
    def bytes(self) -> int:
        """Memory of the map."""
        return self._kernels.bytes

    # ---- pixels to voxels -------------------------------------------------------------------------------------------

    def label_image(self, masks: Sequence[Mask | None], rig: Rig) -> labels.Painted:
        """The masks painted into colour pixels as the parameters want it."""
        p = self._parameters.masks
        if p.one_vote:
            return labels.smallest_on_top(masks, rig.color, p.erosion)
        if p.disjoint:
            return labels.disjoint(masks, rig.color, p.window, p.min_pixels)
        return labels.combinations(masks, rig.color)

    def _set_rig(self, rig: Rig) -> None:
        if rig == self._rig:
            return
        self._rig = rig
        self._rays = projection.pixel_rays(rig.depth)
        self._color = None if rig.registered else projection.color_lookup(rig, self._rays)
        self._skip = np.zeros((rig.depth.height, rig.depth.width), np.uint8)
        self._near = np.zeros_like(self._skip)

    def observe(self, frame: Frame, painted: labels.Painted) -> Region:
        """Depth pixels to voxels with their masks. Raises InputError where the pose leaves the map's range."""
        self._set_rig(frame.rig)
        p = self._parameters
        transform = projection.voxel_transform(frame.world_from_depth, p.map.voxel_size, self._rays, self._max_mm)
        depth = read_only(np.ascontiguousarray(frame.depth))
        paint.depth_steps(depth, p.masks.step_margin if p.masks.one_vote else 0, self._near, self._skip)
        view = View(depth, self._skip, self._max_mm, self._rays, transform, self._color)
        keys, voxel, label, count = self._kernels.count_pixels(view, painted.image)
        members, masks = painted.members, len(painted.masks)
        if p.masks.one_vote:
            most = pixels.majority(len(keys), voxel, label, count)
            mask = np.array([masks, *(group[0] for group in members[1:])], np.int32)[most]
            pair_voxel, pair_mask = np.arange(len(keys), dtype=np.int32), mask
            if not p.evolution.background:
                pair_voxel, pair_mask = pair_voxel[mask < masks], mask[mask < masks]
        else:
            pair_voxel, pair_mask = _expanded(voxel, label, members, masks, p.evolution.background or p.evolution.veto)
            if p.masks.inliers:
                kept = inliers(voxel_index(keys), pair_voxel, pair_mask, masks)
                pair_voxel, pair_mask = pair_voxel[kept], pair_mask[kept]
        voxels_of_mask = np.bincount(pair_mask, minlength=masks + 1)[:masks]
        away = voxel_index(keys).astype(np.int64) - transform.b
        worth = vote_worth((away * away).sum(1), p.map.voxel_size, p.evolution.near)
        return Region(keys, pair_voxel, pair_mask, masks, voxels_of_mask, worth)

    # ---- reading ----------------------------------------------------------------------------------------------------

    def look(self, region: Region, fragments: int) -> Look:
        """The map where the frame looks. fragments: highest fragment id so far."""
        rows, owner, label = self._kernels.look_up(region.keys, self._hidden)
        found = self._kernels.shares(rows, label, region.pair_voxel, region.pair_mask, region.masks, fragments)
        return Look(rows, owner, label, *found)

    # ---- writing ----------------------------------------------------------------------------------------------------

    def move(self, region: Region, look: Look, mask: int, source: int, target: int) -> tuple[int, int]:
        """Rename the votes for `source` under a mask to `target`; returns the voxels moved, and their votes as if all
        had been cast from here."""
        voxel = region.pair_voxel[region.pair_mask == mask]
        voxel = voxel[look.rows[voxel] != EMPTY]
        voxel = voxel[np.argsort(look.rows[voxel])]
        under = look.rows[voxel]
        before = self._kernels.counts_of(under, np.full_like(under, source))
        rows = under[before > 0]
        self._kernels.move_votes(rows, source, target)
        self._changed += [(rows, np.full_like(rows, source)), (rows, np.full_like(rows, target))]
        return len(rows), int((before // region.worth[voxel]).sum())

    def vote(self, region: Region, look: Look, held: Bools, main: Ints, undecided: Bools) -> Longs:
        """Count the votes of every (voxel, mask) pair; returns how many voxels of each mask abstained (masks + 1,).

        held (masks, columns of look): the mask holds the fragment; main (masks,): the fragment of what nobody holds, or
        EMPTY for no vote; undecided (masks,): what nobody holds votes for nothing. A voxel under no mask votes for
        background if its fragment is held (the detector saw the thing and left this voxel out) or if it has none."""
        p = self._parameters.evolution
        target = self._kernels.targets(region, look, held, main, undecided, p.voxel_votes)
        if p.veto:
            target[region.pair_mask == region.masks] = 0
        doubtful = (target == 0) & (look.label[region.pair_voxel] == 0)
        amount = np.where(doubtful, 1, 2 if p.background else 1).astype(np.int32) * region.worth[region.pair_voxel]
        casts = target != EMPTY
        voxel = region.pair_voxel[casts]
        self._add_rows(region, look, voxel)
        self._add_votes(look.rows[voxel], target[casts], amount[casts])
        abstained: Longs = np.bincount(region.pair_mask[~casts], minlength=region.masks + 1)
        return abstained

    def _add_votes(self, rows: Ints, fragment: Ints, amount: Ints) -> None:
        """Count votes; fragment 0 = background, NAMELESS = ids beyond the limit."""
        bare = (fragment == 0) & self._parameters.evolution.veto
        if bare.any():
            self._bare = _enough(self._bare, self.voxels)
            np.add.at(self._bare, rows[bare], amount[bare])
            self._changed.append((rows[bare], fragment[bare]))
            rows, fragment, amount = rows[~bare], fragment[~bare], amount[~bare]
        fragment = np.where(fragment == NAMELESS, 0, fragment)
        self._kernels.add_votes(rows, fragment, amount)
        self._changed.append((rows, self._named(fragment)))

    def _named(self, fragment: Ints) -> Ints:
        """Fragments of the kernels as the map names them: with a limit of ids, 0 is what has no name."""
        return np.where(fragment == 0, np.int32(NAMELESS), fragment) if self._slots else fragment

    def _counts(self, rows: Ints, fragment: Ints) -> Ints:
        bare = (fragment == 0) & self._parameters.evolution.veto
        counts = self._kernels.counts_of(rows, np.where(fragment == NAMELESS, 0, fragment))
        return np.where(bare, _enough(self._bare, self.voxels)[rows], counts) if bare.any() else counts

    def _add_rows(self, region: Region, look: Look, voxel: Ints) -> None:
        """Rows for voxels that get their first vote, numbered by key; look.rows learns them."""
        new = np.unique(voxel[look.rows[voxel] == EMPTY])
        new = new[np.argsort(region.keys[new])]
        look.rows[new] = np.arange(self.voxels, self.voxels + len(new), dtype=np.int32)
        self._new_keys.append(region.keys[new])
        self._kernels.add_rows(region.keys[new])

    def settle(self, region: Region, look: Look) -> tuple[VoxelChanges, Ints]:
        """The end of a frame: full voxels halve. Returns what it changed, and the owners of the region's voxels."""
        touched = distinct(np.concatenate([rows for rows, _ in self._changed]))
        if self._parameters.evolution.background and self._parameters.evolution.halving:
            self._changed.append(self._kernels.halve(touched, 2 * self._parameters.evolution.halving))
        row, what = (np.concatenate([part[i] for part in self._changed]).astype(np.int64) for i in (0, 1))
        packed = distinct((row << 32) | (what - NAMELESS))
        row32, what32 = (packed >> 32).astype(np.int32), ((packed & 0xFFFFFFFF) + NAMELESS).astype(np.int32)
        owner, share = self._kernels.owners(touched)
        first_new, self._told, self._changed = self._told, self.voxels, []
        index, self._new_keys = voxel_index(np.concatenate(self._new_keys)), []
        changes = VoxelChanges(first_new, index, row32, what32, self._counts(row32, what32), touched, owner, share)
        rows = self._kernels.look_up(region.keys, 1)[0] if self._parameters.association.one_by_one else look.rows
        return changes, self._kernels.owners(rows)[0]

    # ---- the whole map ----------------------------------------------------------------------------------------------

    def votes(self) -> tuple[Longs, Ints, Ints, Ints]:
        """Keys of all voxels by number, and all votes: voxel number, fragment (0 = background), count; unordered."""
        keys, row, fragment, count = self._kernels.votes()
        bare = np.flatnonzero(self._bare[: len(keys)]).astype(np.int32)
        fragment = np.concatenate([self._named(fragment), np.zeros_like(bare)])
        return keys, np.concatenate([row, bare]), fragment, np.concatenate([count, self._bare[bare]])

    def whole(self) -> VoxelChanges:
        """All voxels and votes, as one step would tell them that made them all."""
        keys, row, fragment, count = self.votes()
        order = np.lexsort((fragment, row))
        rows = np.arange(len(keys), dtype=np.int32)
        return VoxelChanges(
            0,
            voxel_index(keys),
            row[order],
            fragment[order],
            count[order],
            rows,
            *self._kernels.owners(rows),
        )

    def restore(self, keys: Longs, row: Ints, fragment: Ints, count: Ints) -> None:
        """Fill an empty engine with voxels by number and their votes, as `votes` gives them."""
        self._kernels.add_rows(keys.astype(np.int64))
        self._add_votes(row, fragment, count)
        self._told, self._changed = self.voxels, []


def vote_worth(square: Longs, voxel_size: float, near: float) -> Ints:
    """What a vote for each voxel counts: near / distance, rounded down, from 1 to MOST_WORTH. square: distances from
    the camera in voxels, squared."""
    edge, reach = round(voxel_size * 1_000_000), round(near * 1_000_000)
    worth = np.ones(len(square), np.int32)
    for times in range(2, MOST_WORTH + 1) if reach else ():
        worth += times * times * square <= reach * reach // (edge * edge)
    return worth


def common_pixels(a: Mask, b: Mask) -> int:
    """Pixels that two masks share."""
    return int(paint.common_pixels(read_only(a.bits), a.box, read_only(b.bits), b.box))


def _enough(array: Ints, size: int) -> Ints:
    """The array with room for `size`, half as much again at least when it grows; new places are 0."""
    if size <= len(array):
        return array
    return np.concatenate([array, np.zeros(max(size - len(array), len(array) // 2), np.int32)])


def distinct(array: NDArray[Number]) -> NDArray[Number]:
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
