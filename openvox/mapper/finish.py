"""From votes to a finished map: which voxel shows which instance, and which instances exist. No vote is altered."""

from __future__ import annotations

from collections.abc import Mapping
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import FinishParameters, MapperParameters
from openvox.core.types import Event, InstanceMap, InstanceSummary
from openvox.core.voxels import voxel_index
from openvox.mapper.codebook import Fragment, Memory, memory_of
from openvox.mapper.life import Life, exists, members_of
from openvox.mapper.parts import without_holes, without_loose_parts
from openvox.mapper.ranking import confidences, existence, vote_share
from openvox.mapper.smoothing import Tally, face_neighbours, shown_instances, sum_by_instance

Longs = NDArray[np.int64]
Ints = NDArray[np.int32]
CAPTIONS = 30
"""So many captions of an instance are kept in the map."""


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
    bare = (fragment == 0) & parameters.evolution.veto
    total = np.bincount(row[~bare], count[~bare], len(keys)).astype(np.int64)
    tally = Tally(*sum_by_instance(row[voted], owner[fragment[voted]], count[voted]), total)
    beside = face_neighbours(keys)
    shown = shown_instances(tally, beside, parameters.finish.smoothing, parameters.finish.rounds)
    vetoed = np.bincount(row[bare], count[bare], len(keys)) > total
    shown = np.where(vetoed | (total < parameters.finish.min_votes), 0, shown)
    members = members_of(instance_of)
    memories = {instance: memory_of(fragments[f] for f in group) for instance, group in members.items()}
    gone: dict[int, str] = {}
    if parameters.finish.existence:
        shown = _existing(shown, keys, memories, parameters.finish, gone)
        shown = _sure(shown, existence(shown, tally, memories), parameters.finish.min_confidence, gone)
    shown = without_holes(shown, beside, parameters.finish.holes)
    confidence = confidences(shown, tally, beside, memories, parameters.finish)
    kept = list(confidence)
    share = vote_share(shown, tally)
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


def _existing(
    shown: Longs, keys: Longs, memories: Mapping[int, Memory], parameters: FinishParameters, gone: dict[int, str]
) -> Longs:
    """Without the objects that fail the existence tests and loose parts of the others. Reasons go to `gone`."""
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
    return without_loose_parts(shown, keys, parameters.min_part)


def _sure(shown: Longs, existence: Mapping[int, int], floor: float, gone: dict[int, str]) -> Longs:
    """Without the objects whose existence is not sure enough. Reasons go to `gone`."""
    unsure = [i for i, value in existence.items() if value < fixedpoint.q20(floor)]
    gone.update((i, f"existence {existence[i] / fixedpoint.Q20:.3f} is below {floor:g}") for i in unsure)
    return _without(shown, unsure)


def _without(shown: Longs, gone: list[int]) -> Longs:
    return np.where(np.isin(shown, gone), 0, shown)


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
