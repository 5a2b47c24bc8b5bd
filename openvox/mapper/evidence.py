"""Which fragments are one thing: evidence for and against, counted frame by frame, and clusters made from it.

T(f, g) counts how often f and g lay in one mask, S(f, g) how often they lay in different ones. Instances are clusters
of the graph with weights q T - 16 contradiction S, where q = 16 for fragments of equal captions, less for unlike ones.
Contradictions are summed, so that one weld does not chain through the room.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import LifecycleParameters
from openvox.mapper.codebook import Fragment

Pair = tuple[int, int]


def pair(f: int, g: int) -> Pair:
    """The two ids, smaller first."""
    return (f, g) if f < g else (g, f)


class Evidence:
    """Pair counts of all fragments, and the instances that follow from them."""

    def __init__(self, parameters: LifecycleParameters) -> None:
        self._contradiction = round(16 * parameters.contradiction)
        self._use_captions = parameters.captions
        self._halving = parameters.halving
        self.together: dict[Pair, int] = {}
        self.apart: dict[Pair, int] = {}
        self._neighbours: dict[int, set[int]] = {}
        self._weight: dict[Pair, int] = {}
        self._component: dict[int, tuple[int, ...]] = {}
        self.instance_of: dict[int, int] = {}
        """Smallest fragment id of each fragment's instance."""
        self.members: dict[int, tuple[int, ...]] = {}
        """Fragments of each instance, ascending."""
        self._before: dict[int, int] = {}
        self._new: set[int] = set()
        self._snapshot: Mapping[int, int] | None = None

    def add_fragment(self, f: int) -> None:
        """A fragment of its own."""
        self._component[f] = (f,)
        self.instance_of[f] = f
        self._new.add(f)
        self._snapshot = None
        self.members[f] = (f,)
        self._neighbours[f] = set()

    def restore(self, together: Mapping[Pair, int], apart: Mapping[Pair, int]) -> None:
        """Take over the counts of an earlier run as they are: large ones are halved only when they grow."""
        self.together, self.apart = dict(together), dict(apart)
        for f, g in together:
            self._join(f, g)

    def add_together(self, f: int, g: int, amount: int) -> None:
        """f and g lay in one mask."""
        self._count(self.together, pair(f, g), amount)
        self._join(f, g)

    def neighbours(self, f: int) -> list[int]:
        """Fragments that once lay in one mask with f, ascending."""
        return sorted(self._neighbours[f])

    def add_apart(self, f: int, g: int, amount: int) -> None:
        """f and g lay in different masks of one frame."""
        self._count(self.apart, pair(f, g), amount)

    def _join(self, f: int, g: int) -> None:
        self._neighbours[f].add(g)
        self._neighbours[g].add(f)

    def _count(self, counts: dict[Pair, int], key: Pair, amount: int) -> None:
        counts[key] = counts.get(key, 0) + amount
        if 0 < self._halving < self.together.get(key, 0) + self.apart.get(key, 0):
            for each in (self.together, self.apart):
                if key in each:
                    each[key] >>= 1

    def kept_apart(self, f: int, g: int) -> bool:
        """True if f and g were seen apart, and not more often together."""
        apart = self.apart.get(pair(f, g), 0)
        return apart > 0 and self.together.get(pair(f, g), 0) <= apart

    def _pair_weight(self, key: Pair, fragments: Mapping[int, Fragment]) -> int:
        likeness = 16
        f, g = fragments[key[0]], fragments[key[1]]
        if self._use_captions and f.square and g.square:
            cosine = fixedpoint.cosine(int(f.direction @ g.direction), f.square, g.square)
            likeness = (16 * cosine + (1 << 19)) >> 20
        return likeness * self.together.get(key, 0) - self._contradiction * self.apart.get(key, 0)

    def update(self, changed: Iterable[int], fragments: Mapping[int, Fragment]) -> None:
        """Cluster anew what the changed fragments (their counts or captions) can reach."""
        start: set[int] = set()
        for f in changed:
            start.update(self._component[f])
            for g in self.neighbours(f):
                self._weight[pair(f, g)] = self._pair_weight(pair(f, g), fragments)
        done: set[int] = set()
        for f in sorted(start):
            if f not in done:
                component = self._reach(f)
                done.update(component)
                self._regroup(component)

    def regrouped(self) -> dict[int, int]:
        """What changed since this was last asked for: the instance then of every older fragment of each instance that
        lost or gained one; empty if none did."""
        moved = {f: old for f, old in self._before.items() if self.instance_of[f] != old and f not in self._new}
        concerned = {*moved.values(), *(self.instance_of[f] for f in moved)}
        members = {f for instance in concerned for f in self.members.get(instance, ())} - self._new
        self._before, self._new = {}, set()
        return {f: moved.get(f, self.instance_of[f]) for f in sorted(members.union(moved))}

    def snapshot(self) -> Mapping[int, int]:
        """Instance of every fragment as it is now; made anew only after a change."""
        if self._snapshot is None:
            self._snapshot = MappingProxyType(self.instance_of.copy())
        return self._snapshot

    def _regroup(self, component: tuple[int, ...]) -> None:
        groups: dict[int, list[int]] = {}
        for f, instance in cluster(component, self._edges(component)).items():
            self._component[f] = component
            if self.instance_of[f] != instance:
                self._before.setdefault(f, self.instance_of[f])
                self.instance_of[f], self._snapshot = instance, None
            groups.setdefault(instance, []).append(f)
            self.members.pop(f, None)
        self.members.update((instance, tuple(group)) for instance, group in groups.items())

    def _reach(self, f: int) -> tuple[int, ...]:
        reached, waiting = {f}, [f]
        while waiting:
            here = waiting.pop()
            for g in self.neighbours(here):
                if g not in reached and self._weight.get(pair(here, g), 0) > 0:
                    reached.add(g)
                    waiting.append(g)
        return tuple(sorted(reached))

    def _edges(self, component: tuple[int, ...]) -> dict[Pair, int]:
        edges = {}
        for i, f in enumerate(component):
            for g in component[i + 1 :]:
                weight = self._weight.get((f, g))
                if weight is None:
                    weight = -self._contradiction * self.apart.get((f, g), 0)
                if weight:
                    edges[f, g] = weight
        return edges


def cluster(nodes: Iterable[int], edges: Mapping[Pair, int]) -> dict[int, int]:
    """Greedy additive edge contraction: join the heaviest positive pair, add up its weights, repeat.

    edges: weight of (smaller, larger) node. Ties go to the lowest pair. Returns each node's cluster, named by its
    smallest node."""
    name = {node: node for node in nodes}
    weights: dict[int, dict[int, int]] = {node: {} for node in name}
    for (f, g), weight in edges.items():
        weights[f][g] = weight
        weights[g][f] = weight
    while True:
        best: tuple[int, int, int] | None = None
        for f, row in weights.items():
            for g, weight in row.items():
                if f < g and weight > 0 and (best is None or (-weight, f, g) < best):
                    best = (-weight, f, g)
        if best is None:
            return name
        _, keep, gone = best
        for other, weight in weights.pop(gone).items():
            del weights[other][gone]
            if other != keep:
                total = weights[keep].get(other, 0) + weight
                weights[keep][other] = weights[other][keep] = total
        name = {node: keep if cluster == gone else cluster for node, cluster in name.items()}
