"""Instance association: which instance each mask of a frame belongs to, against the map before the frame.

Pure: reads what the engine found where the frame looks, and the codebook; changes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import MapperParameters
from openvox.core.types import Candidate, Mask
from openvox.mapper import equations
from openvox.mapper.codebook import Fragment, feature_of

MIN_OVERLAP = 4
"""Voxels of a fragment that must lie under a mask before the mask can hold it by the fragment's side."""


@dataclass(eq=False)
class Association:
    """What is decided about one mask: the fragments it holds and its main one, filled in by the steps of the mapper."""

    mask: int
    voxels: int
    by: str = "new"
    main: int = 0
    held: set[int] = field(default_factory=set)
    candidates: tuple[Candidate, ...] = ()
    chosen: Candidate | None = None
    """The candidate whose fragment is the main one; None if the mask founds a fragment."""
    visibility: int = fixedpoint.Q20
    credibility: int = equations.FULL_WEIGHT


def associate_frame(
    masks: Sequence[Mask | None],
    features: Sequence[NDArray[np.int64] | None],
    voxels: NDArray[np.int64],
    columns: NDArray[np.int32],
    theta_sum: NDArray[np.int64],
    overlap: NDArray[np.int64],
    fragments: Mapping[int, Fragment],
    instance_of: Mapping[int, int],
    members_of: Mapping[int, Sequence[int]],
    parameters: MapperParameters,
) -> list[Association]:
    """One association a mask; masks are independent of each other given the map before the frame, eqs. 2 to 5.

    masks: None where a mask is skipped as too small; features (D,) as rint(127 f); voxels (masks,) |V_m|; columns (f,)
    fragment ids; theta_sum, overlap (masks + 1, f); members_of: all fragments of an instance. A mask that is to found a
    fragment has main = 0 and by = "new"."""
    members = _columns_by_instance(columns, instance_of)
    pieces = {instance: [fragments[f] for f in members_of[instance]] for instance in members}
    known = {instance: feature_of(group) for instance, group in pieces.items()}
    out = []
    for m, mask in enumerate(masks):
        one = Association(m, int(voxels[m]), by="small" if mask is None else "empty" if voxels[m] == 0 else "new")
        if one.by == "new":
            one.candidates = _candidates(theta_sum[m], overlap[m], members, known, features[m], one.voxels, parameters)
        out.append(one)
    if parameters.association.containment:
        _contain(out, voxels, columns, overlap)
    _exceed(out, members, columns, theta_sum, parameters)
    for one in out:
        _judge(one, pieces, instance_of)
    return out


def _judge(one: Association, pieces: Mapping[int, Sequence[Fragment]], instance_of: Mapping[int, int]) -> None:
    """Visibility and credibility of a mask that joined an instance; a founder's feature enters with weight 1."""
    if not one.main:
        return
    instance = instance_of[one.main]
    one.chosen = next(candidate for candidate in one.candidates if candidate.instance == instance)
    one.visibility = equations.visibility_ratio(one.voxels, sum(part.voxels for part in pieces[instance]))
    one.credibility = equations.credibility(one.chosen.a, one.visibility)


def _columns_by_instance(columns: NDArray[np.int32], instance_of: Mapping[int, int]) -> dict[int, list[int]]:
    members: dict[int, list[int]] = {}
    for column, fragment in enumerate(columns.tolist()):
        members.setdefault(instance_of[fragment], []).append(column)
    return members


def _candidates(
    theta_sum: NDArray[np.int64],
    overlap: NDArray[np.int64],
    members: Mapping[int, list[int]],
    known: Mapping[int, tuple[NDArray[np.int64], int]],
    feature: NDArray[np.int64] | None,
    voxels: int,
    parameters: MapperParameters,
) -> tuple[Candidate, ...]:
    """Every instance with a vote under the mask, best A first, the lowest id first among equals."""
    weight_geometry = fixedpoint.millionths(parameters.association.weight_geometry)
    weight_feature = fixedpoint.millionths(parameters.association.weight_feature)
    square_mask = 0 if feature is None else int(feature @ feature)
    out = []
    sums, overlaps = theta_sum.tolist(), overlap.tolist()
    for instance, group in members.items():
        total = sum(sums[column] for column in group)
        common = sum(overlaps[column] for column in group)
        if total == 0 and common == 0:
            continue
        s_geo = equations.geometric_similarity(total, voxels)
        s_fea = 0
        if feature is not None:
            direction, square = known[instance]
            s_fea = equations.feature_similarity(int(direction @ feature), square, square_mask)
        a = equations.association_probability(s_geo, s_fea, weight_geometry, weight_feature)
        out.append(Candidate(instance, common, s_geo, s_fea, a))
    return tuple(sorted(out, key=lambda candidate: (-candidate.a, candidate.instance)))


def _contain(
    out: Sequence[Association], voxels: NDArray[np.int64], columns: NDArray[np.int32], overlap: NDArray[np.int64]
) -> None:
    """A mask holds a fragment if most of the fragment's masked voxels, and a quarter of those in view, lie in the mask,
    or if most of the mask is the fragment. Its main fragment is the held one with most voxels there."""
    if not len(columns):
        return
    masked = overlap[:-1].sum(0)
    in_view = overlap.sum(0)
    for one in out:
        if one.by != "new":
            continue
        common = overlap[one.mask]
        lies_in = (2 * common >= masked) & (4 * common >= in_view) & (common >= MIN_OVERLAP)
        fills = (2 * common >= voxels[one.mask]) & (common > 0)
        held = np.flatnonzero(lies_in | fills)
        if len(held):
            one.by = "containment"
            one.held = set(columns[held].tolist())
            one.main = int(columns[held[np.argmax(common[held])]])


def _exceed(
    out: Sequence[Association],
    members: Mapping[int, list[int]],
    columns: NDArray[np.int32],
    theta_sum: NDArray[np.int64],
    parameters: MapperParameters,
) -> None:
    """Masks that hold nothing join their best candidate if A exceeds the threshold, unless another mask holds it."""
    threshold = fixedpoint.q20(parameters.association.threshold)
    taken = {fragment for one in out for fragment in one.held}
    for one in out:
        if one.by != "new" or not one.candidates or one.candidates[0].a <= threshold:
            continue
        group = members[one.candidates[0].instance]
        if taken.intersection(columns[group].tolist()):
            continue
        best = max(group, key=lambda column: (int(theta_sum[one.mask, column]), -column))
        one.by, one.main, one.held = "threshold", int(columns[best]), {int(columns[best])}
