"""Instances against true objects on points: average precision the ScanNet way, shares of points, and each object.

Every point carries at most one label, so predictions never overlap. Counts are exact; ratios are formed once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MIN_POINTS = 15
"""True objects with fewer are ignored: neither to be found nor an error to find. Such predictions are left out."""
THRESHOLDS = tuple(percent / 100 for percent in range(50, 100, 5))
LEAST_LABELLED = 0.25
"""Of an object's points, or it is missed."""
PIECE = 0.10
"""Of an object's points in one prediction make it a piece; two pieces make a split."""
WELD = 0.25
"""Of the points of two objects in the main prediction of one of them make them merged."""
FAR = 0.75
"""Of the points of objects without a label: more, and the truth is likely of another place; of two rooms .83."""
ELSEWHERE = (
    "most of the truth's objects lie in no instance of the map; is the truth of this recording, in the same "
    "coordinates, and of no more than was mapped?"
)


@dataclass(frozen=True, eq=False, slots=True)
class Overlaps:
    """How many points each true object shares with each predicted instance."""

    true_ids: NDArray[np.int64]
    """(T,) ascending, above 0."""
    ids: NDArray[np.int64]
    """(P,) ascending, above 0."""
    table: NDArray[np.int64]
    """(T + 1, P + 1): row 0 = background points, column 0 = points without a label."""

    @classmethod
    def count(cls, truth: NDArray[np.int64], labels: NDArray[np.int64]) -> Overlaps:
        """truth, labels: (N,), an id a point, 0 = none."""
        true_ids, ids = np.unique(truth[truth > 0]), np.unique(labels[labels > 0])
        row = np.where(truth > 0, np.searchsorted(true_ids, truth) + 1, 0)
        column = np.where(labels > 0, np.searchsorted(ids, labels) + 1, 0)
        shape = (len(true_ids) + 1, len(ids) + 1)
        table = np.bincount(row * shape[1] + column, minlength=shape[0] * shape[1]).reshape(shape)
        return cls(true_ids, ids, table.astype(np.int64))

    @property
    def shared(self) -> NDArray[np.int64]:
        """(T, P): points of the true object in the instance."""
        return np.asarray(self.table[1:, 1:])

    @property
    def true_points(self) -> NDArray[np.int64]:
        """(T,): points of each true object."""
        return np.asarray(self.table[1:].sum(1))

    @property
    def points(self) -> NDArray[np.int64]:
        """(P,): points of each instance, those on background included."""
        return np.asarray(self.table[:, 1:].sum(0))

    def iou(self) -> NDArray[np.float64]:
        """(T, P): shared points over points in either."""
        union = self.true_points[:, None] + self.points - self.shared
        return np.asarray(self.shared / np.maximum(union, 1))


@dataclass(frozen=True, slots=True)
class ObjectScore:
    """How one true object fared."""

    id: int
    points: int
    ignored: bool
    """Too small to be counted anywhere."""
    best_iou: float
    split_into: tuple[int, ...]
    """Instances holding at least a tenth of its points."""
    merged_with: tuple[int, ...]
    """True objects in the instance that holds most of its points."""
    missed: bool


@dataclass(frozen=True, slots=True)
class InstanceScore:
    """The numbers of one labelling of the points; None where the truth has nothing to measure."""

    ap: float | None
    ap50: float | None
    ap25: float | None
    f50: float
    miou: float | None
    spill: float
    missed_share: float
    wrong_share: float
    predicted: int
    true: int
    split: int
    merged: int
    missed: int
    objects: tuple[ObjectScore, ...]


def score_instances(
    truth: NDArray[np.int64], labels: NDArray[np.int64], confidence: Mapping[int, float]
) -> InstanceScore:
    """truth, labels: (N,), true object and predicted instance of each point, 0 = none.

    confidence: of each instance; ranks predictions, then by number of points, then by id.
    """
    overlaps = Overlaps.count(truth, labels)
    iou = overlaps.iou()
    matches = {threshold: _match(overlaps, iou, confidence, threshold) for threshold in (0.25, *THRESHOLDS)}
    precision = {threshold: average_precision(*match) for threshold, match in matches.items()}
    objects = _objects(overlaps, iou)
    live = [o for o in objects if not o.ignored]
    found, missing = matches[0.5]
    hits = sum(found)
    spill, missed, wrong = _shares(overlaps)
    return InstanceScore(
        ap=_mean([precision[threshold] for threshold in THRESHOLDS]) if live else None,
        ap50=precision[0.5],
        ap25=precision[0.25],
        f50=2 * hits / max(2 * hits + (len(found) - hits) + missing, 1),
        miou=float(np.mean([o.best_iou for o in live])) if live else None,
        spill=spill,
        missed_share=missed,
        wrong_share=wrong,
        predicted=int((overlaps.points >= MIN_POINTS).sum()),
        true=len(live),
        split=sum(len(o.split_into) > 1 for o in live),
        merged=sum(bool(o.merged_with) for o in live),
        missed=sum(o.missed for o in live),
        objects=objects,
    )


def _match(
    overlaps: Overlaps, iou: NDArray[np.float64], confidence: Mapping[int, float], threshold: float
) -> tuple[list[bool], int]:
    """Down the ranking: did each prediction find a free object (those that cover ignored ones drop out); misses."""
    points = overlaps.points
    ignored = overlaps.true_points < MIN_POINTS
    on_ignored = overlaps.shared[ignored].sum(0) / np.maximum(points, 1)
    free = ~ignored
    found = []
    for column in _ranking(overlaps, confidence):
        candidates = np.where(free, iou[:, column], 0.0)
        best = int(np.argmax(candidates)) if len(candidates) else 0  # the lowest id on a tie
        if len(candidates) and candidates[best] > threshold:
            free[best] = False
            found.append(True)
        elif on_ignored[column] <= threshold:
            found.append(False)
    return found, int(free.sum())


def _ranking(overlaps: Overlaps, confidence: Mapping[int, float]) -> list[int]:
    """Columns of the predictions that count, best first."""
    ids, points = overlaps.ids.tolist(), overlaps.points.tolist()
    counted = [column for column in range(len(ids)) if points[column] >= MIN_POINTS]
    return sorted(counted, key=lambda c: (-confidence.get(ids[c], 0.0), -points[c], ids[c]))


def average_precision(found: list[bool], missing: int) -> float | None:
    """ScanNet's: precision times its half-step convolution of recall, (recall 0, precision 1) appended.

    found: of each prediction, best first; missing: objects that none found. None if there is no object."""
    total = sum(found) + missing
    if not total:
        return None
    if not found:
        return 0.0
    hits = np.cumsum(found)
    precision = np.append((hits / np.arange(1, len(found) + 1))[::-1], 1.0)
    recall = np.append((hits / total)[::-1], 0.0)
    step = np.convolve(np.concatenate([recall[:1], recall, [0.0]]), [-0.5, 0.0, 0.5], "valid")
    return round(float(np.dot(precision, step)), 12)


def _mean(values: list[float | None]) -> float:
    return round(float(np.mean(np.array(values, np.float64))), 12)


def _shares(overlaps: Overlaps) -> tuple[float, float, float]:
    """Of background points: labelled; of object points: without a label, and with another label than the main one."""
    counted = overlaps.table[1:][overlaps.true_points >= MIN_POINTS]
    background, total = int(overlaps.table[0].sum()), int(counted.sum())
    labelled = int(counted[:, 1:].sum())
    main = int(counted[:, 1:].max(1, initial=0).sum())
    return (
        float(overlaps.table[0, 1:].sum() / background) if background else 0.0,
        float(1 - labelled / total) if total else 0.0,
        float((labelled - main) / total) if total else 0.0,
    )


def _objects(overlaps: Overlaps, iou: NDArray[np.float64]) -> tuple[ObjectScore, ...]:
    ids, true_ids = overlaps.ids, overlaps.true_ids
    points = overlaps.true_points
    counted = points >= MIN_POINTS
    scores = []
    for row, shared in enumerate(overlaps.shared):
        n = int(points[row])
        main = int(np.argmax(shared)) if len(shared) else 0  # the lowest id on a tie
        merged = np.zeros(len(true_ids), np.bool_)
        if len(shared) and shared[main] >= WELD * n:
            merged = counted & (overlaps.shared[:, main] >= WELD * points)
            merged[row] = False
        pieces = (shared >= PIECE * n) & (shared > 0)
        scores.append(
            ObjectScore(
                id=int(true_ids[row]),
                points=n,
                ignored=not counted[row],
                best_iou=float(iou[row].max(initial=0.0)),
                split_into=tuple(ids[pieces].tolist()),
                merged_with=tuple(true_ids[merged].tolist()),
                missed=int(shared.sum()) / n < LEAST_LABELLED,
            )
        )
    return tuple(scores)
