"""From votes to a finished map: which voxel shows which instance, and which instances exist. No vote is altered."""

from __future__ import annotations

from collections.abc import Mapping
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import FinishParameters, MapperParameters
from openvox.core.types import Event, InstanceMap, InstanceSummary
from openvox.core.voxels import rows_of, voxel_index, voxel_key
from openvox.mapper.codebook import Fragment, Memory, memory_of
from openvox.mapper.life import Life, exists, members_of
from openvox.mapper.ranking import FACES, existence, expected_overlap, relative_scores, sums, vote_shares

Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
CHUNK = 1 << 13
"""Voxels that are smoothed at a time."""
CAPTIONS = 30
"""So many captions of an instance are kept in the map."""
HALF_NEIGHBOURS = tuple((i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0))
"""One of each opposite pair of the 26 neighbours."""


def finished_map(
    votes: tuple[Longs, Ints, Ints, Ints],
    fragments: Mapping[int, Fragment],
    instance_of: Mapping[int, int],
    life: Life,
    dimensions: int,
    parameters: MapperParameters,
) -> InstanceMap:
    """The map of all votes: voxel keys by number, then voxel number, fragment and count of every vote, unordered."""
    keys, row, fragment, count = _sorted_votes(*votes)
    owner = np.array([0, *(instance_of[f] for f in range(1, len(fragments) + 1))], np.int32)
    voted = fragment >= int(parameters.evolution.veto)  # nameless votes and a veto's are in totals alone
    own_row, own_id, own_count = _sum_by_instance(row[voted], owner[fragment[voted]], count[voted])
    shown = _shown(keys, own_row, own_id, own_count, parameters.finish.smoothing)
    members = members_of(instance_of)
    memories = {instance: memory_of(fragments[f] for f in group) for instance, group in members.items()}
    bare = (fragment == 0) & parameters.evolution.veto
    total = np.bincount(row[~bare], count[~bare], len(keys)).astype(np.int64)
    vetoed = np.bincount(row[bare], count[bare], len(keys)) > total
    shown = np.where(vetoed | (total < parameters.finish.min_votes), 0, shown)
    own = _own(own_row, own_id, own_count, shown)
    share = _share(own, total)
    gone: dict[int, str] = {}
    shown = _existing(shown, keys, memories, parameters.finish, gone)
    theta = _mean_theta(shown, share)
    scores = relative_scores(memories)
    shares = vote_shares(shown, own, total, sums(own_id, own_count))
    sure = existence(shares, memories, scores)
    if parameters.finish.existence:
        shown = _sure(shown, sure, parameters.finish.min_confidence, gone)
    own = _own(own_row, own_id, own_count, shown)
    share = _share(own, total)
    kept = [i for i in np.unique(shown).tolist() if i > 0]
    ranking = parameters.finish.ranking if parameters.finish.existence else "share"
    if ranking == "overlap":
        confidence = expected_overlap(
            shown, keys, fixedpoint.Q20 - share, {i: shares[i] for i in kept}, memories, scores
        )
    elif ranking == "existence":
        confidence = sure
    elif ranking == "matches":
        confidence = {i: value * memories[i].matched // (memories[i].matched + 2) for i, value in theta.items()}
    else:
        confidence = theta
    index = voxel_index(keys)
    used = np.unique(fragment[fragment > 0])
    size = parameters.map.voxel_size
    return InstanceMap(
        voxel_index=index,
        vote_offset=np.searchsorted(row, np.arange(len(keys) + 1)).astype(np.int64),
        vote_fragment=fragment.astype(np.int32),
        vote_count=count.astype(np.int32),
        fragment_id=used.astype(np.int32),
        fragment_instance=np.where(np.isin(owner[used], kept), owner[used], 0).astype(np.int32),
        voxel_instance=shown.astype(np.int32),
        voxel_confidence=(share / fixedpoint.Q20).astype(np.float32),
        instance_id=np.array(kept, np.int32),
        instance_confidence=np.array([confidence[i] / fixedpoint.Q20 for i in kept], np.float32),
        feature=np.array([unit(memories[i].total) for i in kept], np.float32).reshape(len(kept), dimensions),
        feature_weight=np.array([memories[i].weight / 4096 for i in kept], np.float64),
        voxel_size=size,
        vote_unit=0.5 if parameters.evolution.background else 1.0,
        instances=tuple(_summary(i, memories[i], life, index[shown == i], size) for i in kept),
        events=tuple(
            Event(life.frame, "dropped", i, (), gone.get(i, "no voxel shows it: others have more votes"))
            for i in sorted(set(members) - set(kept))
        ),
    )


def unit(total: Longs) -> NDArray[np.float32]:
    """A codebook sum at unit length, the same bits everywhere: the norm is an integer square root. Null stays null."""
    short = fixedpoint.shortened(total)
    square = int(short @ short)
    if square == 0:
        return np.zeros(len(total), np.float32)
    norm = isqrt(square << 40) / fixedpoint.Q20
    return (short.astype(np.float64) / norm).astype(np.float32)


def _sorted_votes(keys: Longs, row: Ints, fragment: Ints, count: Ints) -> tuple[Longs, Ints, Ints, Ints]:
    """Voxels by key, only those that hold a vote; votes by voxel, then fragment."""
    order = np.argsort(keys)
    held = np.bincount(row, count, len(keys)) > 0
    order = order[held[order]]
    place = np.full(len(keys), -1, np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    by = np.lexsort((fragment, place[row]))
    by = by[count[by] > 0]
    return keys[order], place[row[by]], fragment[by], count[by]


def _sum_by_instance(row: Ints, instance: Ints, count: Ints | Longs) -> tuple[Ints, Ints, Longs]:
    """Votes summed per (voxel, instance), by voxel, then instance."""
    packed = (row.astype(np.int64) << 32) | instance
    order = np.argsort(packed, kind="stable")  # quick: voxels are mostly in order already
    packed = packed[order]
    first = np.flatnonzero(np.diff(packed, prepend=-1))
    summed = np.add.reduceat(count[order], first, dtype=np.int64) if len(first) else count.astype(np.int64)
    packed = packed[first]
    return (packed >> 32).astype(np.int32), (packed & 0xFFFFFFFF).astype(np.int32), summed


def _shown(keys: Longs, row: Ints, instance: Ints, count: Longs, weight: int) -> Longs:
    """The instance that each voxel shows by kernel counting: weight x own counts + those of the six face neighbours.

    weight 0 = own counts alone. Votes by voxel. Some voxels at a time: seven times all votes would take much memory."""
    offset = np.searchsorted(row, np.arange(len(keys) + 1))
    shown = np.zeros(len(keys), np.int64)
    for begin in range(0, len(keys), CHUNK):
        end = min(begin + CHUNK, len(keys))
        index = voxel_index(keys[begin:end]).astype(np.int64)
        parts = [(np.arange(begin, end), max(1, weight))]
        if weight:
            parts += [(rows_of(keys, voxel_key(index + np.array(face))), 1) for face in FACES]
        counted = [_votes_of(rows, offset, instance, count, factor) for rows, factor in parts]
        votes = _sum_by_instance(*(np.concatenate([part[i] for part in counted]) for i in range(3)))
        shown[begin:end] = _strongest(*votes, end - begin)
    return shown


def _votes_of(rows: Longs, offset: Longs, instance: Ints, count: Longs, factor: int) -> tuple[Ints, Ints, Longs]:
    """The votes of the voxels `rows` (-1 = none) times a factor: place in rows, instance, count."""
    known = np.maximum(rows, 0)
    lengths = np.where(rows >= 0, offset[known + 1] - offset[known], 0)
    place = np.repeat(np.arange(len(rows)), lengths)
    vote = np.arange(len(place)) + np.repeat(offset[known] - (np.cumsum(lengths) - lengths), lengths)
    return place.astype(np.int32), instance[vote], count[vote] * factor


def _strongest(row: Ints, instance: Ints, count: Longs, voxels: int) -> Longs:
    """The instance with most votes in each voxel if it beats background strictly, the lowest id on a tie; else 0."""
    rank = (count << 32) | (0xFFFFFFFF - instance.astype(np.int64))
    best, background = np.zeros(voxels, np.int64), np.zeros(voxels, np.int64)
    ids = instance > 0
    np.maximum.at(best, row[ids], rank[ids])
    background[row[~ids]] = count[~ids]
    return np.where(best >> 32 > background, 0xFFFFFFFF - (best & 0xFFFFFFFF), 0)


def _own(row: Ints, instance: Ints, count: Longs, shown: Longs) -> Longs:
    """Votes of each voxel for the instance that it shows (for background where none is shown)."""
    own = np.zeros(len(shown), np.int64)
    mine = instance == shown[row]
    own[row[mine]] = count[mine]
    return own


def _share(own: Longs, total: Longs) -> Longs:
    """Own votes over all votes of each voxel, Q20."""
    share: Longs = (own << 20) // np.maximum(total, 1)
    return share


def _existing(
    shown: Longs, keys: Longs, memories: Mapping[int, Memory], parameters: FinishParameters, gone: dict[int, str]
) -> Longs:
    """Without the objects that fail the existence tests and loose parts of the others. Reasons go to `gone`."""
    if not parameters.existence:
        return shown
    sizes = np.bincount(shown)
    for i in np.flatnonzero(sizes).tolist():
        if not i:
            continue
        frames = min(parameters.min_frames, memories[i].seen) if parameters.brief else parameters.min_frames
        if not exists(memories[i], int(sizes[i]), parameters, frames):
            gone[i] = (
                f"matched in {memories[i].matched} of {memories[i].seen} frames that saw it, {sizes[i]} voxels: too few"
            )
    shown = _without(shown, list(gone))
    part = _parts(shown, keys)
    sizes, part_sizes = np.bincount(shown), np.bincount(part)
    share = fixedpoint.millionths(parameters.min_part)
    loose = fixedpoint.MILLION * part_sizes[part] < share * sizes[shown]
    return np.where(loose, 0, shown)


def _sure(shown: Longs, existence: Mapping[int, int], floor: float, gone: dict[int, str]) -> Longs:
    """Without the objects whose existence is not sure enough. Reasons go to `gone`."""
    unsure = [i for i, value in existence.items() if value < fixedpoint.q20(floor)]
    gone.update((i, f"existence {existence[i] / fixedpoint.Q20:.3f} is below {floor:g}") for i in unsure)
    return _without(shown, unsure)


def _without(shown: Longs, gone: list[int]) -> Longs:
    return np.where(np.isin(shown, gone), 0, shown)


def _parts(shown: Longs, keys: Longs) -> Longs:
    """The 26-connected part of each voxel, named by its lowest row; rows of equal instance alone are joined."""
    part = np.arange(len(keys))
    rows = np.flatnonzero(shown > 0)
    index = voxel_index(keys[rows]).astype(np.int64)
    for step in HALF_NEIGHBOURS if len(rows) else ():
        other = rows_of(keys, voxel_key(index + np.array(step)))
        same = (other >= 0) & (shown[rows] == shown[other])
        part = _joined(part, rows[same], other[same])
    return part


def _joined(part: Longs, a: Longs, b: Longs) -> Longs:
    """The parts where those of rows a[i] and b[i] are one; a part is named by its lowest row, before and after."""
    while True:
        a, b = part[a], part[b]
        apart = a != b
        if not apart.any():
            return part
        a, b = a[apart], b[apart]
        np.minimum.at(part, np.maximum(a, b), np.minimum(a, b))
        while not np.array_equal(part, lower := part[part]):
            part = lower


def _mean_theta(shown: Longs, share: Longs) -> dict[int, int]:
    """Mean theta (Q20) of every shown instance, ids ascending."""
    sums = np.zeros(int(shown.max(initial=0)) + 1, np.int64)
    np.add.at(sums, shown, share)
    sizes = np.bincount(shown)
    return {i: int(sums[i]) // int(sizes[i]) for i in np.flatnonzero(sizes).tolist() if i}


def _summary(i: int, memory: Memory, life: Life, index: NDArray[np.int32], size: float) -> InstanceSummary:
    low, high = index.min(0) * size, (index.max(0) + 1) * size
    confirmed = life.confirmed.get(i)
    return InstanceSummary(
        id=i,
        caption=memory.caption,
        captions=tuple((text, support / 4096) for text, support in memory.captions[:CAPTIONS]),
        observations=memory.matched,
        first_frame=memory.first_frame,
        last_frame=memory.last_frame,
        state="tentative" if confirmed is None else "confirmed",
        confirmed_frame=confirmed,
        bounds=(
            (float(low[0]), float(low[1]), float(low[2])),
            (float(high[0]), float(high[1]), float(high[2])),
        ),
        voxels=len(index),
        named=memory.named,
    )
