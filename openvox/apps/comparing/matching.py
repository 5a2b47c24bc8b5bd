"""Instances of two maps matched by the space they share: what split, merged, appeared or vanished.

What is compared are voxels. Maps of one voxel size meet voxel by voxel; of two sizes, each voxel's centre is looked up
in the other map (the voxel that contains it, else the nearest within 1.5 of that map's edges), both ways round.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from openvox.apps.described import voxel_centers
from openvox.apps.scoring.labels import REACH, labels_of_rows, rows_at_points
from openvox.core.types import InstanceMap

MOSTLY = 0.5
"""Share of an instance that must lie in another for the two to have to do with each other."""
ALIKE = 0.1
"""Intersection over union from which on one instance is another's match, though most of the larger lies elsewhere."""
Shares = Mapping[tuple[int, int], float]
"""(instance, instance of the other map) to the share of the first one's voxels that lie in the second."""
Labels = NDArray[np.int64]
"""(N,): for each voxel of a map, the instance of the other map there; 0 = background or nothing."""


@dataclass(frozen=True)
class Match:
    """An instance of each map that are taken for the same."""

    a: int
    b: int
    iou: float
    """What they share over what either holds, by voxels (by their share of each map's voxels if the sizes differ)."""


@dataclass(frozen=True)
class Matching:
    """Every instance of A is matched, merged or vanished, every one of B matched, a piece or appeared: one of them."""

    matches: tuple[Match, ...]
    """By a."""
    split: Mapping[int, tuple[int, ...]]
    """Instance of a to its pieces in b, largest overlap first, its match among them."""
    merged: Mapping[int, tuple[int, ...]]
    """Instance of b to the instances of a that it took together, its match among them, ascending."""
    appeared: tuple[int, ...]
    """Of b: most of it is in no instance of a that has a match."""
    vanished: tuple[int, ...]
    """Of a: most of it is in no instance of b that has a match."""
    a_in_b: Labels = field(repr=False)
    b_in_a: Labels = field(repr=False)


def match_instances(a: InstanceMap, b: InstanceMap) -> Matching:
    """One to one, the largest intersection over union first (lowest ids on a tie), among pairs of which one lies
    mostly in the other and neither mostly in a third; what is left over is a piece, was merged, appeared or vanished.
    """
    a_in_b, b_in_a = _labels_in(a, b), _labels_in(b, a)
    of_a, of_b = _shares(a, a_in_b), _shares(b, b_in_a)
    iou = {(i, j): _iou(of_a.get((i, j)), of_b.get((j, i))) for i, j in {*of_a, *((i, j) for j, i in of_b)}}
    to_b, to_a = _one_to_one(iou, of_a, of_b)
    home_of = {i: j for i, j in _homes(of_a).items() if i not in to_b and j in to_a}
    origin_of = {j: i for j, i in _homes(of_b).items() if j not in to_a and i in to_b}
    split = _groups(origin_of, to_b)
    return Matching(
        matches=tuple(Match(i, j, iou[i, j]) for i, j in sorted(to_b.items())),
        split={i: tuple(sorted(js, key=lambda j, i=i: (-of_a.get((i, j), 0.0), j))) for i, js in split.items()},  # type: ignore[misc]
        merged={j: tuple(sorted(parts)) for j, parts in _groups(home_of, to_a).items()},
        appeared=tuple(j for j in b.instance_id.tolist() if j not in to_a and j not in origin_of),
        vanished=tuple(i for i in a.instance_id.tolist() if i not in to_b and i not in home_of),
        a_in_b=a_in_b,
        b_in_a=b_in_a,
    )


def _one_to_one(
    iou: Mapping[tuple[int, int], float], of_a: Shares, of_b: Shares
) -> tuple[dict[int, int], dict[int, int]]:
    """Matches, from a to b and from b to a."""
    home_of, origin_of = _homes(of_a), _homes(of_b)
    pieced, filled = _covered(origin_of, of_a), _covered(home_of, of_b)

    def fit(i: int, j: int) -> bool:
        home, origin = home_of.get(i), origin_of.get(j)
        if {home, origin} == {None} or home not in (j, None) or origin not in (i, None):
            return False  # of a crumb's whole the most lies elsewhere: there it is looked for
        # a crumb alone is no match, but the largest of many, of which the other consists, is
        return iou[i, j] >= ALIKE or (origin == i and pieced[i] >= MOSTLY) or (home == j and filled[j] >= MOSTLY)

    to_b: dict[int, int] = {}
    to_a: dict[int, int] = {}
    for i, j in sorted(iou, key=lambda pair: (-iou[pair], pair)):
        if i not in to_b and j not in to_a and fit(i, j):
            to_b[i], to_a[j] = j, i
    return to_b, to_a


def _covered(home_of: Mapping[int, int], shares_of_homes: Shares) -> dict[int, float]:
    """Share of each home that is held by those that lie mostly in it."""
    covered: dict[int, float] = {}
    for one, home in sorted(home_of.items()):
        covered[home] = covered.get(home, 0.0) + shares_of_homes.get((home, one), 0.0)
    return covered


def differing_voxels(matching: Matching, a: InstanceMap, b: InstanceMap) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """For each voxel of both maps: it does not belong to the same as in the other map; background is one more thing."""
    to_b = {match.a: match.b for match in matching.matches}
    to_a = {j: i for i, j in to_b.items()}
    return _elsewhere(a, matching.a_in_b, to_b), _elsewhere(b, matching.b_in_a, to_a)


def _elsewhere(one: InstanceMap, there: Labels, match_of: Mapping[int, int]) -> NDArray[np.bool_]:
    expected = np.array([0, *(match_of.get(i, -1) for i in one.instance_id.tolist())], np.int64)
    row = np.searchsorted(one.instance_id, one.voxel_instance) + 1
    row[one.voxel_instance == 0] = 0
    return np.asarray(expected[row] != there)


def _labels_in(one: InstanceMap, other: InstanceMap) -> Labels:
    """The other map's instance at each voxel of `one`."""
    reach = 0.0 if one.voxel_size == other.voxel_size else REACH
    return labels_of_rows(rows_at_points(voxel_centers(one), other, reach), other)


def _shares(one: InstanceMap, there: Labels) -> Shares:
    """Of `one`, whose voxels lie `there` in the other map."""
    mine = one.voxel_instance.astype(np.int64)
    both = (mine > 0) & (there > 0)
    pairs, counts = np.unique(np.stack([mine[both], there[both]], 1), axis=0, return_counts=True)
    sizes = dict(zip(*(values.tolist() for values in np.unique(mine, return_counts=True)), strict=True))
    return {(i, j): count / sizes[i] for (i, j), count in zip(pairs.tolist(), counts.tolist(), strict=True)}


def _iou(share_of_a: float | None, share_of_b: float | None) -> float:
    """n / (A + B - n), of n / A and n / B."""
    return 1.0 / (1.0 / share_of_a + 1.0 / share_of_b - 1.0) if share_of_a and share_of_b else 0.0


def _homes(shares: Shares) -> dict[int, int]:
    """Where most of each instance lies in the other map, if half of it lies in one (the lowest on a tie)."""
    homes: dict[int, int] = {}
    for (one, other), share in sorted(shares.items(), key=lambda item: (-item[1], item[0])):
        if share >= MOSTLY:
            homes.setdefault(one, other)
    return homes


def _groups(home_of: Mapping[int, int], match_of: Mapping[int, int]) -> dict[int, list[int]]:
    """By home, ascending: what lies in it, and its own match first."""
    return {
        home: [*([match_of[home]] if home in match_of else []), *(one for one, at in home_of.items() if at == home)]
        for home in sorted(set(home_of.values()))
    }
