"""What masks of one frame say about fragments: cut what lies under two of them, count who lies with whom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import LifecycleParameters, MapperParameters
from openvox.core.phrases import colors_named
from openvox.core.types import Mask
from openvox.mapper.associate import Association
from openvox.mapper.engines.engine import common_pixels
from openvox.mapper.evidence import Evidence, pair

MIN_CUT = 5
"""Voxels that must lie on either side of a cut."""

MIN_OMITTED = 4
"""Voxels of a fragment that must be in view before a mask can be said to leave it out."""


@dataclass(frozen=True, slots=True)
class Cut:
    """`fragment` lies under two masks; what lies under `mask` goes, what lies under `keeper` stays."""

    fragment: int
    keeper: int
    mask: int


class Nesting:
    """Whether two masks of a frame are nested: their common pixels are at least a share of the smaller one."""

    def __init__(self, masks: Sequence[Mask | None], share: float) -> None:
        self._masks = masks
        self._share = fixedpoint.millionths(share)
        self._areas = [0 if mask is None else mask.area for mask in masks]
        self._known: dict[tuple[int, int], bool] = {}

    def __call__(self, a: int, b: int) -> bool:
        """True if masks a and b of the frame are nested."""
        key = (min(a, b), max(a, b))
        if key not in self._known:
            first, second = self._masks[a], self._masks[b]
            assert first is not None
            assert second is not None
            common = common_pixels(first, second) if _overlap(first.box, second.box) else 0
            smaller = min(self._areas[a], self._areas[b])
            self._known[key] = fixedpoint.MILLION * common >= self._share * smaller
        return self._known[key]


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def cuts(
    masks: Sequence[Mask | None],
    associations: Sequence[Association],
    voxels: NDArray[np.int64],
    columns: NDArray[np.int32],
    overlap: NDArray[np.int64],
    nesting: Nesting,
    parameters: MapperParameters,
) -> list[Cut]:
    """The cuts that this frame asks for, by fragment, then by mask (area down, then position).

    voxels (masks,): |V_m|; columns (f,) fragment ids; overlap (masks + 1, f). Of the masks that hold the fragment and
    have enough of it, the largest keeps it; every other one that is mostly this fragment and not nested with the keeper
    takes its part. A region takes nothing, as it may be a piece; for what stands on a support any share is enough, as a
    cup is little of a table."""
    share = fixedpoint.millionths(parameters.evolution.cut_share)
    kinds = ["" if mask is None or not parameters.lifecycle.kinds else mask.kind for mask in masks]
    order = [m for _, m in sorted((-mask.area, m) for m, mask in enumerate(masks) if mask and associations[m].main)]
    out = []
    for column, fragment in enumerate(columns.tolist()):
        common = [fixedpoint.MILLION * shared for shared in overlap[:-1, column].tolist()]
        least = MIN_CUT * fixedpoint.MILLION
        enough = max(least, share * sum(common) // fixedpoint.MILLION)
        under = [
            m
            for m in order
            if fragment in associations[m].held and common[m] >= (least if kinds[m] == "support" else enough)
        ]
        if len(under) < 2:
            continue
        keeper = max(under, key=lambda m: (int(voxels[m]), -order.index(m)))
        out += [
            Cut(fragment, keeper, m)
            for m in under
            if m != keeper
            and kinds[m] != "region"
            and 2 * common[m] >= fixedpoint.MILLION * int(voxels[m])
            and not nesting(m, keeper)
        ]
    return out


def count_pairs(
    masks: Sequence[Mask | None],
    associations: Sequence[Association],
    columns: NDArray[np.int32],
    overlap: NDArray[np.int64],
    nesting: Nesting,
    evidence: Evidence,
    parameters: LifecycleParameters,
) -> None:
    """Fragments in one mask were seen together, fragments in different masks apart.

    columns (f,) fragment ids; overlap (masks + 1, f)."""
    kinds = ["" if mask is None or not parameters.kinds else mask.kind for mask in masks]
    colors = [colors_named(mask.caption) if mask and parameters.colors else frozenset[str]() for mask in masks]
    mixed = "region" in kinds  # else how clearly a thing is seen says nothing
    visible = _visible_pixels(masks, associations, columns, overlap) if mixed else {}
    holders: dict[int, list[int]] = {}
    for one in associations:
        for f in sorted(one.held):
            holders.setdefault(f, []).append(one.mask)
    fragments = sorted(holders)
    for i, f in enumerate(fragments):
        for g in fragments[i + 1 :]:
            both = [m for m in holders[f] if m in holders[g]]
            if both and not mixed:
                evidence.add_together(f, g, 2)
                continue
            if both:
                clear = {m: min(visible[m].get(f, 0), visible[m].get(g, 0)) >= parameters.clear_pixels for m in both}
                evidence.add_together(f, g, max(_togetherness(kinds[m], clear[m]) for m in both))
                continue
            apart = max(_contradiction(a, b, masks, kinds, colors, nesting) for a in holders[f] for b in holders[g])
            if apart:
                evidence.add_apart(f, g, apart)


def _visible_pixels(
    masks: Sequence[Mask | None],
    associations: Sequence[Association],
    columns: NDArray[np.int32],
    overlap: NDArray[np.int64],
) -> dict[int, dict[int, int]]:
    """About how many pixels of a mask show each of its fragments: its voxels there x pixels to a voxel of the mask."""
    return {
        one.mask: {
            f: mask.area * common // max(1, one.voxels)
            for f, common in zip(columns.tolist(), overlap[one.mask].tolist(), strict=True)
        }
        for one in associations
        if one.held and (mask := masks[one.mask]) is not None
    }


def _togetherness(kind: str, clear: bool) -> int:
    """How much a mask says, in a frame with regions, that what it holds is one thing: 2, thrice for a detector's mask.

    Regions from depth lose small things from afar: what is not seen clearly counts half."""
    amount = 6 if kind == "object" else 2
    return amount if clear else amount // 2


def count_omissions(
    masks: Sequence[Mask | None],
    associations: Sequence[Association],
    columns: NDArray[np.int32],
    overlap: NDArray[np.int64],
    evidence: Evidence,
    parameters: LifecycleParameters,
) -> None:
    """A mask that covers most of a fragment in view and leaves its neighbour in view out says that they are two things.

    Counted once a frame and pair, and only for a neighbour that no mask of the frame holds: a small thing is often
    missed where the large one under it is found, so masks side by side would be too rare a proof. A frame with regions
    proves nothing: what its masks leave out may be a piece. columns (f,) fragment ids; overlap (masks + 1, f)."""
    if parameters.kinds and any(mask is not None and mask.kind == "region" for mask in masks):
        return
    held = {f for one in associations for f in one.held}
    column = {f: c for c, f in enumerate(columns.tolist())}
    in_view = overlap.sum(0).tolist()
    pairs = set()
    for one in associations:
        common = overlap[one.mask].tolist()
        covered = [f for f in sorted(one.held & column.keys()) if 2 * common[column[f]] >= in_view[column[f]]]
        for f, g in [(whole, left) for whole in covered for left in evidence.neighbours(whole)]:
            c = column.get(g)
            if c is not None and g not in held and in_view[c] >= MIN_OMITTED and 4 * common[c] < in_view[c]:
                pairs.add(pair(f, g))
    for f, g in sorted(pairs):
        evidence.add_apart(f, g, parameters.omission)


def _contradiction(
    a: int,
    b: int,
    masks: Sequence[Mask | None],
    kinds: Sequence[str],
    colors: Sequence[frozenset[str]],
    nesting: Nesting,
) -> int:
    """How much two masks say that what they hold is two things: 2, half if nested, twice if one stands on a support.

    Two regions, or two that stand on something, may be pieces of one thing: they say half if they differ in colour or
    the frame has no masks that know better, else nothing. Nor does what stands on something beside a smaller region:
    that does not bear it."""
    if kinds[a] == kinds[b] and kinds[a] in ("region", "support"):
        differ = colors[a] and colors[b] and not colors[a] & colors[b]
        return 1 if differ or not {"object", "support"}.intersection(kinds) else 0
    small, large = sorted((a, b), key=lambda m: _area(masks[m]))
    if kinds[large] == "support" and kinds[small] == "region" and _area(masks[small]) < _area(masks[large]):
        return 0
    amount = 1 if nesting(a, b) else 2
    return 2 * amount if "support" in (kinds[a], kinds[b]) else amount


def _area(mask: Mask | None) -> int:
    return 0 if mask is None else mask.area
