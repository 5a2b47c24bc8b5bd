"""From votes to a finished map: which voxel shows which instance, and which instances exist. No vote is altered."""

from __future__ import annotations

from collections.abc import Mapping
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import FinishParameters, MapperParameters
from openvox.core.types import Event, InstanceMap, InstanceSummary
from openvox.core.voxels import voxel_index, voxel_key
from openvox.mapper.codebook import Fragment, Memory, memory_of
from openvox.mapper.life import Life, exists, members_of

Longs = NDArray[np.int64]
RIM = 10
"""Voxels at which an instance is about as much rim as body."""
FACES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
HALF_NEIGHBOURS = tuple((i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if (i, j, k) > (0, 0, 0))
"""One of each opposite pair of the 26 neighbours."""


def finished_map(
    votes: tuple[Longs, NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]],
    fragments: Mapping[int, Fragment],
    instance_of: Mapping[int, int],
    life: Life,
    dimensions: int,
    parameters: MapperParameters,
) -> InstanceMap:
    """The map of all votes: voxel keys by number, then voxel number, fragment and count of every vote, unordered."""
    keys, row, fragment, count = _sorted_votes(*votes)
    owner = np.array([0, *(instance_of[f] for f in range(1, len(fragments) + 1))], np.int64)
    voted = fragment >= int(parameters.evolution.veto)  # nameless votes and a veto's are in totals alone
    own_row, own_id, own_count = _sum_by_instance(row[voted], owner[fragment[voted]], count[voted])
    shown = _strongest(*_smoothed(keys, own_row, own_id, own_count, parameters.finish.smoothing), len(keys))
    members = members_of(instance_of)
    memories = {instance: memory_of(fragments[f] for f in group) for instance, group in members.items()}
    bare = (fragment == 0) & parameters.evolution.veto
    total = np.bincount(row[~bare], count[~bare], len(keys)).astype(np.int64)
    vetoed = np.bincount(row[bare], count[bare], len(keys)) > total
    shown = np.where(vetoed | (total < parameters.finish.min_votes), 0, shown)
    share = _share(own_row, own_id, own_count, shown, total)
    gone: dict[int, str] = {}
    shown = _existing(shown, keys, memories, parameters.finish, gone)
    theta, sizes = _mean_theta(shown, share)
    confidence = dict(theta)
    if parameters.finish.existence:
        existence = _existence(theta, memories)
        shown = _sure(shown, existence, parameters.finish.min_confidence, gone)
        if parameters.finish.ranking == "matches":
            confidence = {i: value * memories[i].matched // (memories[i].matched + 2) for i, value in theta.items()}
        elif parameters.finish.ranking == "existence":
            confidence = {i: _expected_overlap(value, theta[i], sizes[i]) for i, value in existence.items()}
    share = _share(own_row, own_id, own_count, shown, total)
    kept = [i for i in np.unique(shown).tolist() if i > 0]
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


def _sorted_votes(
    keys: Longs, row: NDArray[np.int32], fragment: NDArray[np.int32], count: NDArray[np.int32]
) -> tuple[Longs, Longs, Longs, Longs]:
    """Voxels by key, only those that hold a vote; votes by voxel, then fragment."""
    order = np.argsort(keys)
    held = np.bincount(row, count, len(keys)) > 0
    order = order[held[order]]
    place = np.full(len(keys), -1, np.int64)
    place[order] = np.arange(len(order))
    by = np.lexsort((fragment, place[row]))
    by = by[count[by] > 0]
    return keys[order], place[row[by]], fragment[by].astype(np.int64), count[by].astype(np.int64)


def _sum_by_instance(row: Longs, instance: Longs, count: Longs) -> tuple[Longs, Longs, Longs]:
    """Votes summed per (voxel, instance), by voxel, then instance."""
    packed, where = np.unique((row << 32) | instance, return_inverse=True)
    summed = np.zeros(len(packed), np.int64)
    np.add.at(summed, where, count)
    return packed >> 32, packed & 0xFFFFFFFF, summed


def _smoothed(keys: Longs, row: Longs, instance: Longs, count: Longs, weight: int) -> tuple[Longs, Longs, Longs]:
    """Kernel counting: weight x own counts + those of the six face neighbours. 0 = own counts alone."""
    if weight == 0 or not len(keys):
        return row, instance, count
    index = voxel_index(keys).astype(np.int64)
    parts = [(row, instance, count * weight)]
    for face in FACES:
        neighbour = _rows_of(keys, voxel_key(index + np.array(face)))[row]
        hit = neighbour >= 0
        parts.append((neighbour[hit], instance[hit], count[hit]))
    return _sum_by_instance(*(np.concatenate([part[i] for part in parts]) for i in range(3)))


def _rows_of(keys: Longs, wanted: Longs) -> Longs:
    """Row of each wanted key among the ascending keys, -1 if there is none."""
    where = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[where] == wanted, where, -1)


def _strongest(row: Longs, instance: Longs, count: Longs, voxels: int) -> Longs:
    """The instance with most votes in each voxel if it beats background strictly, the lowest id on a tie; else 0."""
    rank = (count << 32) | (0xFFFFFFFF - instance)
    best, background = np.zeros(voxels, np.int64), np.zeros(voxels, np.int64)
    ids = instance > 0
    np.maximum.at(best, row[ids], rank[ids])
    background[row[~ids]] = count[~ids]
    return np.where(best >> 32 > background, 0xFFFFFFFF - (best & 0xFFFFFFFF), 0)


def _share(row: Longs, instance: Longs, count: Longs, shown: Longs, total: Longs) -> Longs:
    """Votes of the shown instance over all votes of each voxel in Q20 (background's where none is shown)."""
    own = np.zeros(len(shown), np.int64)
    mine = instance == shown[row]
    own[row[mine]] = count[mine]
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
        if i and not exists(memories[i], int(sizes[i]), parameters):
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
    if not len(keys):
        return part
    index = voxel_index(keys).astype(np.int64)
    edges = []
    for step in HALF_NEIGHBOURS:
        other = _rows_of(keys, voxel_key(index + np.array(step)))
        here = np.flatnonzero((other >= 0) & (shown > 0))
        here = here[shown[here] == shown[other[here]]]
        edges.append(np.stack([here, other[here]]))
    a, b = np.concatenate(edges, 1)
    while True:
        before = part.copy()
        low = np.minimum(part[a], part[b])
        np.minimum.at(part, part[a], low)
        np.minimum.at(part, part[b], low)
        while not np.array_equal(part, part[part]):
            part = part[part]
        if np.array_equal(before, part):
            return part


def _mean_theta(shown: Longs, share: Longs) -> tuple[dict[int, int], dict[int, int]]:
    """Mean theta (Q20) and number of voxels of every shown instance, ids ascending."""
    sums = np.zeros(int(shown.max(initial=0)) + 1, np.int64)
    np.add.at(sums, shown, share)
    sizes = np.bincount(shown)
    ids = [i for i in np.flatnonzero(sizes).tolist() if i]
    return {i: int(sums[i]) // int(sizes[i]) for i in ids}, {i: int(sizes[i]) for i in ids}


def _existence(theta: Mapping[int, int], memories: Mapping[int, Memory]) -> dict[int, int]:
    """How surely each shown instance is a thing, Q20: mean theta x k/(k+2) x k/v x the square of its relative score
    (k frames matched, v frames that saw it).

    A relative score is the instance's mean detection score over that of all masks, at most 1: what is a good score
    differs between detectors, but a phantom scores below what else the same detector finds."""
    scores = sum(memory.score for memory in memories.values())
    masks = sum(memory.observations for memory in memories.values())
    out = {}
    for i, value in theta.items():
        memory = memories[i]
        k, v = memory.matched, max(1, memory.seen)
        relative = min(fixedpoint.Q20, ((memory.score * masks) << 20) // max(1, scores * memory.observations))
        out[i] = value * k * k * relative * relative // ((k + 2) * v) >> 40
    return out


def _expected_overlap(existence: int, theta: int, voxels: int) -> int:
    """Confidence, Q20: existence x the overlap that one may hope for, theta x n/(n + RIM), as small things are mostly
    rim."""
    return existence * theta * voxels // (voxels + RIM) >> 20


def _summary(i: int, memory: Memory, life: Life, index: NDArray[np.int32], size: float) -> InstanceSummary:
    low, high = index.min(0) * size, (index.max(0) + 1) * size
    confirmed = life.confirmed.get(i)
    return InstanceSummary(
        id=i,
        caption=memory.captions[0][0] if memory.captions else "",
        captions=tuple((text, support / 4096) for text, support in memory.captions[:10]),
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
    )
