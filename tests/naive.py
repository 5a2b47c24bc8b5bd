"""The mapper once more, slow and obvious: dictionaries, sets, loops and Python integers. numpy only reads pixels.

It holds the real mapper: equal decisions and equal maps, bit for bit. Where both could be wrong in the same way, the
tests with numbers by hand decide (test_equations, test_projection, test_evidence, test_finish).
Masks and fragments are numbers; a voxel is (x, y, z); id 0 is the background.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, product

import naive_finish
from naive_view import MILLION, ONE, Pixel, View, Voxel, cosine, dot, pixels_of, short, strongest, summed, view_of

from openvox.core.mapper_parameters import MapperParameters
from openvox.core.types import Candidate, Decision, Frame, InstanceMap, Mask

Votes = dict[Voxel, dict[int, int]]
Pair = tuple[int, int]


# ---- clustering -----------------------------------------------------------------------------------------------------


def clusters(nodes: Iterable[int], weight: Mapping[Pair, int]) -> dict[int, int]:
    """Join the heaviest positive pair of groups until there is none; a group is named by its smallest node."""
    groups = [{node} for node in sorted(nodes)]
    while True:
        best = None
        for a, b in combinations(sorted(groups, key=min), 2):
            total = sum(weight.get((min(f, g), max(f, g)), 0) for f in a for g in b)
            if total > 0 and (best is None or total > best[0]):
                best = (total, a, b)
        if best is None:
            return {node: min(group) for group in groups for node in group}
        groups = [group for group in groups if group not in best[1:]] + [best[1] | best[2]]


# ---- the map --------------------------------------------------------------------------------------------------------


@dataclass
class Piece:
    """A fragment's memory; frames are counted from 0 among those looked at."""

    total: list[int]
    weight: int = 0
    captions: Counter[tuple[str, str]] = field(default_factory=Counter)
    matched: set[int] = field(default_factory=set)
    seen: set[int] = field(default_factory=set)
    score: int = 0
    observations: int = 0


@dataclass
class Choice:
    """What is decided about one mask."""

    by: str
    main: int = 0
    held: set[int] = field(default_factory=set)
    candidates: tuple[Candidate, ...] = ()
    chosen: Candidate | None = None
    visibility: int = 0
    credibility: int = 0
    abstained: int = 0


class Twin:
    """The map. `votes` are alpha, in half votes where background takes part."""

    def __init__(self, parameters: MapperParameters) -> None:
        self.p = parameters
        self.votes: Votes = {}
        self.fragments: dict[int, Piece] = {}
        self.instance_of: dict[int, int] = {}
        self.together: Counter[Pair] = Counter()
        self.apart: Counter[Pair] = Counter()
        self.moved: set[Voxel] = set()
        self.bare: Counter[Voxel] = Counter()
        self.sizes: Counter[int] = Counter()
        self.eye: tuple[int, ...] = (0, 0, 0)
        self.looked = 0
        self.dimensions = 0

    def step(self, frame: Frame, masks: Sequence[Mask] | None) -> tuple[Decision, ...]:
        if masks is None:
            return ()
        self.dimensions = max([self.dimensions, *(len(m.embedding) for m in masks if m.embedding is not None)])
        every = [pixels_of(mask) for mask in masks]
        areas = {m: area for m, area in enumerate(every) if len(area) >= self.p.masks.min_pixels}
        view = view_of(frame, len(masks), areas, self.p)
        edge = self.p.map.voxel_size * 1000.0
        self.eye = tuple(math.floor(x * 1000.0 / edge) for x in frame.world_from_depth.translation)
        features = [
            None if m.embedding is None else [min(127, max(-127, round(float(x) * 127.0))) for x in m.embedding]
            for m in masks
        ]
        areas = {m: areas[m] for m in view.large}
        order = sorted(range(len(masks)), key=lambda m: (-len(every[m]), m))
        self.sizes = Counter(self.owner(voxel) for voxel in self.votes)
        if self.p.association.one_by_one:
            in_view = sum((self.overlaps(voxels) for voxels in (*view.under, view.bare)), Counter[int]())
            choices = self.one_by_one(masks, areas, view, features, order)
            self.halve(view.all)
        else:
            choices = self.associate(view, areas, features)
            self.found(choices, order)
            if self.p.evolution.cut:
                self.cut(masks, areas, view, choices)
            if self.p.lifecycle.evidence:
                self.count_pairs(masks, areas, view, choices)
                self.count_omissions(masks, areas, view, choices)
            in_view = sum((self.overlaps(voxels) for voxels in (*view.under, view.bare)), Counter[int]())
            self.halve(self.vote(view, choices) | self.moved)
            for m, choice in enumerate(choices):
                self.learn(masks[m], features[m], choice)
        for f, voxels in in_view.items():
            if voxels >= 4:
                self.fragments[f].seen.add(self.looked)
        if self.p.lifecycle.evidence:
            self.instance_of = clusters(self.fragments, self.weights())
        self.looked += 1
        self.moved.clear()
        return tuple(self.decision(m, len(view.under[m]), choice) for m, choice in enumerate(choices))

    def look_again(self) -> None:
        """The map stays; what the frames to come count, counts anew."""
        for piece in self.fragments.values():
            piece.matched, piece.seen, piece.score, piece.observations = set(), set(), 0, 0
        self.looked = 0

    def found(self, choices: Sequence[Choice], order: Iterable[int]) -> None:
        for m in order:
            if choices[m].by == "new":
                f, choice = self.new_fragment(), choices[m]
                choice.main, choice.held, choice.visibility, choice.credibility = f, {f}, ONE, 4096

    def one_by_one(
        self,
        masks: Sequence[Mask],
        areas: Mapping[int, set[Pixel]],
        view: View,
        features: Sequence[Sequence[int] | None],
        order: Sequence[int],
    ) -> list[Choice]:
        """Each mask meets the votes of those before it; the voxels under none come last."""
        done: dict[int, Choice] = {}
        for m in order:
            alone = View([voxels if i == m else set() for i, voxels in enumerate(view.under)], set(), view.all)
            choices = self.associate(alone, {i: areas[i] for i in areas if i == m}, features)
            self.found(choices, [m])
            self.vote(alone, [choice if i == m else Choice("small") for i, choice in enumerate(choices)])
            self.learn(masks[m], features[m], choices[m])
            done[m] = choices[m]
        self.vote(View([set() for _ in masks], view.bare, view.all), list(done.values()))
        return [done[m] for m in range(len(masks))]

    # -- association: against the map before the frame, each mask for itself ------------------------------------------

    def owner(self, voxel: Voxel, factor: int = 1) -> int:
        """The strongest fragment if its votes, times `factor`, beat the background; else 0."""
        counts = self.votes.get(voxel, {})
        votes, f = strongest(counts)
        return f if factor * votes > counts.get(0, 0) else 0

    def label(self, voxel: Voxel) -> int:
        """The owner, with hidden evidence: what association goes by."""
        return self.owner(voxel, self.p.association.hidden_evidence if self.p.evolution.background else 1)

    def theta(self, voxel: Voxel, f: int) -> int:
        """Eq. 15."""
        counts = self.votes.get(voxel, {})
        return counts[f] * ONE // sum(counts.values()) if f in counts else 0

    def overlaps(self, voxels: Iterable[Voxel]) -> Counter[int]:
        """C: how many of the voxels have each label."""
        return Counter(label for label in map(self.label, voxels) if label)

    def associate(
        self, view: View, areas: Mapping[int, set[Pixel]], features: Sequence[Sequence[int] | None]
    ) -> list[Choice]:
        choices = []
        for m, voxels in enumerate(view.under):
            by = "small" if m not in areas else "new" if voxels else "empty"
            choices.append(Choice(by, candidates=self.candidates(voxels, features[m]) if voxels else ()))
        if self.p.association.containment:
            self.contain(view, choices)
        taken = {self.instance_of[f] for choice in choices for f in choice.held}
        for m, choice in enumerate(choices):
            if choice.by == "new" and choice.candidates and choice.candidates[0].a > self.threshold():
                best = choice.candidates[0].instance
                if best not in taken:
                    sums = {f: self.theta_sum(view.under[m], f) for f in self.members(best)}
                    choice.main = min(sums, key=lambda f: (-sums[f], f))
                    choice.by, choice.held = "threshold", {choice.main}
            if choice.main:
                self.judge(len(view.under[m]), choice)
        return choices

    def threshold(self) -> int:
        return round(self.p.association.threshold * ONE)

    def theta_sum(self, voxels: Iterable[Voxel], f: int) -> int:
        return sum(self.theta(voxel, f) for voxel in voxels)

    def members(self, instance: int) -> list[int]:
        return [f for f in self.fragments if self.instance_of[f] == instance]

    def candidates(self, voxels: set[Voxel], feature: Sequence[int] | None) -> tuple[Candidate, ...]:
        """Every instance with votes under the mask, the best A first."""
        common = self.overlaps(voxels)
        sums: Counter[int] = Counter()
        overlap: Counter[int] = Counter()
        for f in sorted({f for voxel in voxels for f in self.votes.get(voxel, {}) if f > 0}):
            sums[self.instance_of[f]] += self.theta_sum(voxels, f)
            overlap[self.instance_of[f]] += common[f]
        weights = [round(w * MILLION) for w in (self.p.association.weight_geometry, self.p.association.weight_feature)]
        out = []
        for instance, total in sums.items():
            s_geo = total // len(voxels)  # eq. 8
            codebook = short(summed(self.fragments[f].total for f in self.members(instance)))
            s_fea = 0 if feature is None else cosine(codebook, feature)  # eq. 9
            a = dot(weights, [s_geo, s_fea]) // MILLION
            out.append(Candidate(instance, overlap[instance], s_geo, s_fea, a))
        return tuple(sorted(out, key=lambda c: (-c.a, c.instance)))

    def contain(self, view: View, choices: Sequence[Choice]) -> None:
        """A mask holds what mostly lies in it, and what it mostly is."""
        common = [self.overlaps(voxels) for voxels in view.under]
        masked = sum(common, Counter[int]())
        in_view = masked + self.overlaps(view.bare)
        for m, choice in enumerate(choices):
            for f, c in sorted(common[m].items()):
                lies_in = c >= 4 and 2 * c >= masked[f] and 4 * c >= in_view[f]
                if lies_in or 2 * c >= len(view.under[m]):
                    choice.by = "containment"
                    choice.held.add(f)
            if choice.held:
                choice.main = min(choice.held, key=lambda f: (-common[m][f], f))

    def judge(self, voxels: int, choice: Choice) -> None:
        """Eqs. 16 and 17."""
        instance = self.instance_of[choice.main]
        choice.chosen = next(c for c in choice.candidates if c.instance == instance)
        members = self.members(instance)
        size = sum(self.sizes[f] for f in members)  # before the frame
        choice.visibility = min(ONE, voxels * ONE // size) if size else ONE
        choice.credibility = max(0, choice.chosen.a * choice.visibility // 2**28)

    # -- evolution ----------------------------------------------------------------------------------------------------

    def new_fragment(self) -> int:
        f = len(self.fragments) + 1
        self.fragments[f], self.instance_of[f] = Piece([0] * self.dimensions), f
        return f

    def nested(self, a: set[Pixel], b: set[Pixel]) -> bool:
        return MILLION * len(a & b) >= round(self.p.lifecycle.nested * MILLION) * min(len(a), len(b))

    def cut(
        self, masks: Sequence[Mask], areas: Mapping[int, set[Pixel]], view: View, choices: Sequence[Choice]
    ) -> None:
        """A fragment under two masks is cut: what lies under the smaller one moves to a new fragment."""
        common = [self.overlaps(voxels) for voxels in view.under]
        kinds = [mask.kind if self.p.lifecycle.kinds else "" for mask in masks]
        planned = []
        for f in sorted(sum(common, Counter[int]())):
            least = round(self.p.evolution.cut_share * MILLION) * sum(c[f] for c in common)
            over = [
                m
                for m in sorted(areas, key=lambda m: (-len(areas[m]), m))
                if f in choices[m].held
                and common[m][f] >= 5
                and (MILLION * common[m][f] >= least or kinds[m] == "support")
            ]
            keeper = min(over, key=lambda m: (-len(view.under[m]), over.index(m)), default=None)
            for m in over:
                mostly = 2 * common[m][f] >= len(view.under[m])
                piece = kinds[m] == "region"
                if (
                    m != keeper
                    and keeper is not None
                    and mostly
                    and not piece
                    and not self.nested(areas[m], areas[keeper])
                ):
                    planned.append((f, m))
        for f, m in planned:
            self.move(f, view.under[m], choices[m])

    def move(self, f: int, voxels: set[Voxel], choice: Choice) -> None:
        piece, whole = self.new_fragment(), self.fragments[f]
        self.fragments[piece].matched, self.fragments[piece].seen = set(whole.matched), set(whole.seen)
        moved = []
        for voxel in voxels:
            if f in self.votes.get(voxel, {}):
                self.moved.add(voxel)
                self.votes[voxel][piece] = self.votes[voxel].pop(f)
                moved.append(self.votes[voxel][piece] // self.worth(voxel))
        factor = round(self.p.evolution.cut_inheritance * MILLION)
        inherited = factor * sum(moved) // (MILLION * max(1, len(moved)))
        self.count(self.together, (f, piece), max(inherited, self.p.evolution.cut_least))
        choice.held = choice.held - {f} | {piece}
        if choice.main == f:
            choice.main, choice.by, choice.chosen = piece, "cut", None
            choice.visibility, choice.credibility = ONE, 4096

    def count(self, counts: Counter[Pair], pair: Pair, amount: int) -> None:
        """Add to a pair's count; many are halved, both kinds."""
        counts[pair] += amount
        if amount and 0 < self.p.lifecycle.halving < self.together[pair] + self.apart[pair]:
            self.together[pair] //= 2
            self.apart[pair] //= 2

    def count_pairs(
        self, masks: Sequence[Mask], areas: Mapping[int, set[Pixel]], view: View, choices: Sequence[Choice]
    ) -> None:
        """Fragments in one mask were seen together, in different masks apart."""
        use = self.p.lifecycle.kinds
        regions = {m for m in areas if use and masks[m].kind == "region"}
        supports = {m for m in areas if use and masks[m].kind == "support"}
        only_regions = len(regions) == len(areas)
        holders: dict[int, set[int]] = {}
        for m, choice in enumerate(choices):
            for f in choice.held:
                holders.setdefault(f, set()).add(m)
        for f, g in combinations(sorted(holders), 2):
            both = holders[f] & holders[g]
            if both:
                amounts = []
                for m in both:
                    said = regions and masks[m].kind == "object"
                    voxels = self.overlaps(view.under[m])
                    shown = [len(areas[m]) * voxels[h] // max(1, len(view.under[m])) for h in (f, g)]
                    unclear = regions and min(shown) < self.p.lifecycle.clear_pixels
                    amounts.append((6 if said else 2) // (2 if unclear else 1))
                self.count(self.together, (f, g), max(amounts))
                continue
            amounts = []
            for a, b in product(holders[f], holders[g]):
                amount = 1 if self.nested(areas[a], areas[b]) else 2
                if {a, b} & supports:
                    amount *= 2
                if {a, b} <= regions or {a, b} <= supports:  # may be pieces of one thing
                    amount = int(only_regions or self.differ_in_color(masks[a], masks[b]))
                for s, r in ((a, b), (b, a)):
                    if s in supports and r in regions and len(areas[r]) < len(areas[s]):  # it cannot bear it
                        amount = 0
                amounts.append(amount)
            self.count(self.apart, (f, g), max(amounts))

    def differ_in_color(self, a: Mask, b: Mask) -> bool:
        """Both captions say a colour, and none that the other says. Only for captions without a place."""
        first, second = (set(mask.caption.split()) & {"red", "green", "blue"} for mask in (a, b))
        return self.p.lifecycle.colors and bool(first and second) and not first & second

    def count_omissions(
        self, masks: Sequence[Mask], areas: Mapping[int, set[Pixel]], view: View, choices: Sequence[Choice]
    ) -> None:
        """A mask that covers one fragment leaves another, which no mask holds, in view out: seen apart."""
        if self.p.lifecycle.kinds and any(masks[m].kind == "region" for m in areas):
            return
        common = [self.overlaps(voxels) for voxels in view.under]
        in_view = sum(common, self.overlaps(view.bare))
        held = {f for choice in choices for f in choice.held}
        for f, g in sorted({*self.together, *((b, a) for a, b in self.together)}):
            if g in held or in_view[g] < 4:
                continue
            says = [
                m
                for m in areas
                if f in choices[m].held
                and in_view[f]
                and 2 * common[m][f] >= in_view[f]
                and 4 * common[m][g] < in_view[g]
            ]
            if says:
                self.count(self.apart, (min(f, g), max(f, g)), self.p.lifecycle.omission)

    def vote(self, view: View, choices: Sequence[Choice]) -> set[Voxel]:
        """Eq. 14: every voxel under a mask votes; with the background rule, voxels under none as well."""
        background = self.p.evolution.background
        held = {f for choice in choices for f in choice.held}
        cast: list[tuple[Voxel, int, int]] = []
        for m, choice in enumerate(choices):
            for voxel in view.under[m]:
                f = self.target(voxel, choice)
                choice.abstained += f == 0
                cast.append((voxel, f, 2 if background else 1))
        cast = [vote for vote in cast if vote[1]]
        if self.p.evolution.veto:
            self.bare.update({voxel: self.worth(voxel) for voxel in view.bare})
        for voxel in () if self.p.evolution.veto else view.bare:
            own = self.label(voxel)
            if own in held or own == 0:
                cast.append((voxel, 0, 2 if own else 1))
        slots = self.p.association.slots if self.p.association.one_by_one else 0
        for voxel, f, amount in cast:
            counts = self.votes.setdefault(voxel, {})
            if f not in counts and 0 < slots <= sum(other > 0 for other in counts):
                f = -1
            counts[f] = counts.get(f, 0) + amount * self.worth(voxel)
        return {voxel for voxel, _, _ in cast}

    def worth(self, voxel: Voxel) -> int:
        """What a vote counts: near / distance to the camera's voxel, from 1 to 4."""
        square = sum((a - b) ** 2 for a, b in zip(voxel, self.eye, strict=True))
        edge, near = round(self.p.map.voxel_size * MILLION), round(self.p.evolution.near * MILLION)
        return max([1, *(k for k in (2, 3, 4) if near and k * k * square * edge * edge <= near * near)])

    def halve(self, voxels: Iterable[Voxel]) -> None:
        """Full voxels halve their counts, at the end of a frame."""
        limit = 2 * self.p.evolution.halving
        for voxel in voxels:
            counts = self.votes.get(voxel, {})
            if self.p.evolution.background and limit and sum(counts.values()) > limit:
                self.votes[voxel] = {f: n // 2 for f, n in counts.items() if n // 2}

    def target(self, voxel: Voxel, choice: Choice) -> int:
        """The fragment that a voxel under a mask votes for; 0 = it abstains."""
        if not self.p.evolution.voxel_votes:
            return choice.main
        own = self.label(voxel)
        if own in choice.held:
            return own
        _, known = strongest(self.votes.get(voxel, {}), among=choice.held)
        return known or (0 if self.undecided(choice.held) else choice.main)

    def undecided(self, held: Collection[int]) -> bool:
        """The mask holds fragments that were seen apart, and not more often together."""
        pairs = combinations(sorted(held), 2)
        return self.p.evolution.abstention and any(0 < self.apart[p] >= self.together[p] for p in pairs)

    def learn(self, mask: Mask, feature: Sequence[int] | None, choice: Choice) -> None:
        """Eqs. 18 and 19, and what else is remembered."""
        if not choice.main:
            return
        piece, w = self.fragments[choice.main], choice.credibility
        if feature is not None:
            piece.total = [total + w * x for total, x in zip(piece.total, feature, strict=True)]
        piece.weight += w
        label = (mask.label or mask.caption) if mask.named else ""
        for word, text, score in ((label, mask.caption, mask.caption_score), *mask.alternatives):
            support = w * round(score * 4096) // 4096
            if text:
                piece.captions[word, text] += support if word else support // 32
        piece.score += round(mask.score * 4096)
        piece.observations += 1
        for f in choice.held:
            self.fragments[f].matched.add(self.looked)

    def weights(self) -> dict[Pair, int]:
        """q T - 16 contradiction S; q = 16, or less for unlike captions."""
        out = {}
        against = round(16 * self.p.lifecycle.contradiction)
        for pair in {**self.together, **self.apart}:
            a, b = (short(self.fragments[f].total) for f in pair)
            q = 16
            if self.p.lifecycle.captions and any(a) and any(b):
                q = (16 * cosine(a, b) + ONE // 2) // ONE
            out[pair] = q * self.together[pair] - against * self.apart[pair]
        return out

    def decision(self, m: int, voxels: int, choice: Choice) -> Decision:
        scores = choice.chosen or Candidate(0, 0, 0, 0, 0)
        return Decision(
            mask=m,
            by=choice.by,
            instance=self.instance_of.get(choice.main, 0),
            fragment=choice.main,
            held=tuple(sorted(choice.held)),
            voxels=voxels,
            abstained=choice.abstained,
            s_geo=scores.s_geo,
            s_fea=scores.s_fea,
            a=scores.a,
            threshold=self.threshold(),
            visibility=choice.visibility,
            credibility=choice.credibility,
            candidates=choice.candidates,
        )

    def finish(self) -> InstanceMap:
        return naive_finish.finish(self.votes, self.bare, self.fragments, self.instance_of, self.dimensions, self.p)


def replay(
    frames: Iterable[tuple[Frame, Sequence[Mask] | None]], parameters: MapperParameters
) -> tuple[list[tuple[Decision, ...]], InstanceMap]:
    """Decisions of every frame, and the finished map."""
    twin = Twin(parameters)
    return [twin.step(frame, masks) for frame, masks in frames], twin.finish()
