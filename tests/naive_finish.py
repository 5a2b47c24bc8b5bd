"""The slow twin's end: from votes to a finished map, by loops over voxels. No vote is altered."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import product
from typing import Protocol

import numpy as np
from naive_view import MILLION, ONE, Voxel, dot, short, strongest, summed

from openvox.core.mapper_parameters import FinishParameters, MapperParameters
from openvox.core.types import InstanceMap

FACES = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
AROUND = tuple(product((-1, 0, 1), repeat=3))


class Piece(Protocol):
    """What is read of a fragment."""

    total: list[int]
    weight: int
    matched: set[int]
    seen: set[int]
    score: int
    observations: int


def beside(voxel: Voxel, step: tuple[int, ...]) -> Voxel:
    return voxel[0] + step[0], voxel[1] + step[1], voxel[2] + step[2]


def by_instance(counts: Mapping[int, int], instance_of: Mapping[int, int]) -> Counter[int]:
    """A voxel's votes for each instance, 0 = background, -1 = nameless."""
    out: Counter[int] = Counter()
    for f, n in counts.items():
        out[instance_of.get(f, f)] += n
    return out


def shown_instance(voxel: Voxel, sums: Mapping[Voxel, Counter[int]], smoothing: int) -> int:
    """The strongest instance if it beats background: smoothing x own counts + those of the six face neighbours."""
    counts = Counter({i: n * (smoothing or 1) for i, n in sums[voxel].items()})
    for face in FACES if smoothing else ():
        counts.update(sums.get(beside(voxel, face), {}))
    votes, instance = strongest(counts)
    return instance if votes > counts[0] else 0


def settled(shown: Mapping[Voxel, int], sums: Mapping[Voxel, Counter[int]], smoothing: int) -> dict[Voxel, int]:
    """One round: a voxel where thing and background meet hears what its neighbours show, but no other thing."""
    after = dict(shown)
    for voxel, mine in shown.items():
        others = [other for face in FACES if (other := beside(voxel, face)) in shown]
        if all((shown[other] > 0) == (mine > 0) for other in others):
            continue
        counts = Counter({i: n * smoothing for i, n in sums[voxel].items()})
        for other in others:
            if 0 in (mine, shown[other]) or mine == shown[other]:
                counts[shown[other]] += min(sums[other].total(), smoothing * sums[voxel].total())
        votes, instance = strongest(counts)
        after[voxel] = instance if votes > counts[0] else 0
    return after


def filled(shown: Mapping[Voxel, int], most: float) -> dict[Voxel, int]:
    """Patches that show nothing, in one instance alone, show it."""
    out = dict(shown)
    for part in parts({voxel for voxel in shown if not shown[voxel]}, FACES):
        around = {shown.get(beside(voxel, face), 0) for voxel in part for face in FACES} - {0}
        for instance in around if len(around) == 1 else ():
            size = sum(other == instance for other in shown.values())
            if MILLION * len(part) <= round(most * MILLION) * size:
                out.update((voxel, instance) for voxel in part)
    return out


def parts(voxels: Collection[Voxel], steps: Sequence[tuple[int, ...]] = AROUND) -> Iterator[set[Voxel]]:
    """Connected parts (26-connected unless told otherwise), by flood fill."""
    left = set(voxels)
    while left:
        part, border = set(), {min(left)}
        while border:
            part |= border
            left -= border
            border = {beside(voxel, step) for voxel in border for step in steps} & left
        yield part


def mean_theta(voxels: Collection[Voxel], share: Mapping[Voxel, int]) -> int:
    return sum(share[voxel] for voxel in voxels) // len(voxels)


def existence(share: int, group: list[Piece], everything: Collection[Piece]) -> int:
    """Overlap of votes times k/(k+2), root of k/v and squared relative score: k frames matched it, v saw it."""
    matched, seen = frames(group)
    k, root = len(matched), math.isqrt(len(matched) * ONE**2 // max(1, len(seen)))
    return share * root * k * relative(group, everything) ** 2 // (k + 2) // ONE**3


def vote_overlap(instance: int, voxels: Collection[Voxel], sums: Mapping[Voxel, Counter[int]]) -> int:
    """Its votes in its voxels, over all votes in them and its own elsewhere."""
    inside, own = sum(sums[v][instance] for v in voxels), sum(counts[instance] for counts in sums.values())
    return inside * ONE // max(1, sum(sums[v].total() for v in voxels) + own - inside)


def relative(group: list[Piece], everything: Collection[Piece]) -> int:
    """The instance's mean score over that of all masks, at most 1."""
    score, masks = sum(piece.score for piece in group), sum(piece.observations for piece in group)
    scores, every = sum(piece.score for piece in everything), sum(piece.observations for piece in everything)
    return min(ONE, score * every * ONE // max(1, scores * masks))


def overlap(instance: int, shown: Mapping[Voxel, int], sums: Mapping[Voxel, Counter[int]], k: int, score: int) -> int:
    """Overlap of votes times (p - d)/(p + d), k/(k+2) and the relative score: p faces, d of them in doubt."""
    unsure = {voxel: ONE - sums[voxel][i] * ONE // max(1, sums[voxel].total()) for voxel, i in shown.items()}
    voxels = [voxel for voxel in shown if shown[voxel] == instance]
    faces = [(voxel, other) for voxel in voxels for face in FACES if (other := beside(voxel, face)) in shown]
    p = len(faces) * ONE
    d = sum(unsure[voxel] + unsure[other] for voxel, other in faces if shown[other] != instance)
    share = vote_overlap(instance, voxels, sums)
    return share * score * k * max(0, p - d) // ((k + 2) * max(1, p + d)) // ONE


def frames(group: list[Piece]) -> tuple[set[int], set[int]]:
    """Frames that matched the instance, and those that saw it."""
    matched = set().union(*(piece.matched for piece in group))
    return matched, matched.union(*(piece.seen for piece in group))


def unit(total: list[int]) -> list[np.float32]:
    vector = short(total)
    square = dot(vector, vector)
    return [np.float32(x / (math.isqrt(square * ONE**2) / ONE) if square else 0.0) for x in vector]


def kept_voxels(voxels: set[Voxel], group: list[Piece], p: FinishParameters) -> set[Voxel]:
    """An instance's voxels without loose parts; none if too few frames matched it or it is too small."""
    matched, seen = frames(group)
    least = min(p.min_frames, len(seen)) if p.brief else p.min_frames
    rare = len(matched) < least or MILLION * len(matched) < round(p.min_share * MILLION) * len(seen)
    if rare or len(voxels) < p.min_voxels:
        return set()
    small = round(p.min_part * MILLION) * len(voxels)
    return {voxel for part in parts(voxels) if MILLION * len(part) >= small for voxel in part}


def finish(
    votes: Mapping[Voxel, Mapping[int, int]],
    bare: Mapping[Voxel, int],
    fragments: Mapping[int, Piece],
    instance_of: Mapping[int, int],
    dimensions: int,
    p: MapperParameters,
) -> InstanceMap:
    order = sorted({voxel for voxel, counts in votes.items() if counts} | set(bare))
    sums = {voxel: by_instance(votes.get(voxel, {}), instance_of) for voxel in order}
    shown = {voxel: shown_instance(voxel, sums, p.finish.smoothing) for voxel in order}
    for _ in range(p.finish.rounds):
        shown = settled(shown, sums, max(1, p.finish.smoothing))
    for voxel in order:
        if sums[voxel].total() < max(p.finish.min_votes, bare.get(voxel, 0)):
            shown[voxel] = 0
    votes = {voxel: {**votes.get(voxel, {}), **({0: bare[voxel]} if voxel in bare else {})} for voxel in order}

    def share(voxel: Voxel) -> int:
        return sums[voxel][shown[voxel]] * ONE // max(1, sums[voxel].total())

    def group(instance: int) -> list[Piece]:
        return [fragments[f] for f in fragments if instance_of[f] == instance]

    def sure(instance: int, voxels: Collection[Voxel]) -> int:
        return existence(vote_overlap(instance, voxels, sums), group(instance), fragments.values())

    for instance in sorted(set(shown.values()) - {0}) if p.finish.existence else ():
        voxels = {voxel for voxel in order if shown[voxel] == instance}
        kept = kept_voxels(voxels, group(instance), p.finish)
        if kept and sure(instance, kept) < round(p.finish.min_confidence * ONE):
            kept = set()
        shown.update((voxel, 0) for voxel in voxels - kept)
    shown = filled(shown, p.finish.holes)
    ids = sorted(set(shown.values()) - {0})
    ranks = {}
    for instance in ids:
        voxels = {voxel for voxel in order if shown[voxel] == instance}
        k = len(frames(group(instance))[0])
        theta = mean_theta(voxels, {voxel: share(voxel) for voxel in voxels})
        ranks[instance] = {
            "share": theta,
            "matches": theta * k // (k + 2),
            "existence": sure(instance, voxels),
            "overlap": overlap(instance, shown, sums, k, relative(group(instance), fragments.values())),
        }[p.finish.ranking if p.finish.existence else "share"]
    used = sorted({f for voxel in order for f in votes[voxel] if f > 0})
    groups = [group(i) for i in ids]
    rows = [sorted(votes[voxel].items()) for voxel in order]
    return InstanceMap(
        voxel_index=np.array(order, np.int32).reshape(-1, 3),
        vote_offset=np.cumsum([0, *map(len, rows)]).astype(np.int64),
        vote_fragment=np.array([f for row in rows for f, _ in row], np.int32),
        vote_count=np.array([n for row in rows for _, n in row], np.int32),
        fragment_id=np.array(used, np.int32),
        fragment_instance=np.array([instance_of[f] if instance_of[f] in ids else 0 for f in used], np.int32),
        voxel_instance=np.array([shown[voxel] for voxel in order], np.int32),
        voxel_confidence=np.array([share(voxel) / ONE for voxel in order], np.float32),
        instance_id=np.array(ids, np.int32),
        instance_confidence=np.array([ranks[i] / ONE for i in ids], np.float32),
        feature=np.array([unit(summed(x.total for x in g)) for g in groups], np.float32).reshape(len(ids), dimensions),
        feature_weight=np.array([sum(x.weight for x in group) / 4096 for group in groups], np.float64),
        voxel_size=p.map.voxel_size,
        vote_unit=0.5 if p.evolution.background else 1.0,
    )
