"""Categories of points by the words that fit their instances best, and objects found by queries in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openvox.apps.ranking import Encoder, cosines, likeness, ranked
from openvox.apps.scoring.instances import Overlaps
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.truth import Query, Truth

BACKGROUND = 0
QUERY_TYPES = ("ontology", "relevance", "functionality")
OVERLAP = 0.25
"""IoU above which an instance is an acceptable object."""
MAX_CLASSES_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Semantics:
    """None where the truth has no such points."""

    miou: float | None
    macc: float | None
    miou_objects: float | None


def read_classes(path: Path) -> tuple[str, ...]:
    """Names of classes, one a line; empty lines are skipped. Raises InputError."""
    try:
        if path.stat().st_size > MAX_CLASSES_BYTES:
            raise InputError(f"{path} is longer than {MAX_CLASSES_BYTES} bytes; expected one name of a class a line")
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is no text file: {error.reason} at byte {error.start}") from None
    names = tuple(line.strip() for line in lines if line.strip())
    if not names:
        raise InputError(f"{path} names no class; expected one a line")
    words = [spoken(name) for name in names]
    for number, word in enumerate(words):
        if word in words[:number]:
            raise InputError(f"{path} names the class {names[number]!r} twice; name each once")
    return names


def spoken(name: str) -> str:
    """A category as one would say it: coffee_table is "coffee table"; case does not count."""
    return name.replace("_", " ").strip().casefold()


def score_semantics(
    truth: Truth, labels: NDArray[np.int64], result: InstanceMap, encoder: Encoder, classes: Sequence[str] | None
) -> Semantics | None:
    """Each instance takes the category whose text is nearest to its feature; None without categories.

    labels: (N,) instance of each point, 0 = none. classes: names in place of the truth's categories; object points of
    other categories are left out. Background points, whatever their category, are one class, and so is what has no
    instance, or one that takes a category of the background only.
    """
    if truth.category is None or not truth.categories:
        return None
    numbers = {spoken(name): number for number, name in list(truth.categories.items())[::-1]}
    names = list(truth.categories.values()) if classes is None else list(classes)
    # a class that the truth does not know gets a number that no point has
    candidates = np.array([numbers.get(spoken(name), -1) for name in names])
    on_object = truth.instance > 0
    actual = np.where(on_object, truth.category, BACKGROUND)
    known = ~on_object | np.isin(truth.category, candidates)
    of_objects = np.unique(actual[on_object & known])
    taken = _nearest_category(result, encoder, [spoken(name) for name in names], candidates)
    only_background = np.setdiff1d(truth.category[~on_object], of_objects)
    taken = np.where(np.isin(taken, only_background), BACKGROUND, taken)
    place = np.searchsorted(result.instance_id, labels)
    predicted = np.where(labels > 0, np.append(taken, BACKGROUND)[place], BACKGROUND)
    miou, macc = class_means(actual[known], predicted[known])
    objects = on_object & known
    return Semantics(miou, macc, class_means(actual[objects], predicted[objects])[0])


def _nearest_category(
    result: InstanceMap, encoder: Encoder, texts: list[str], candidates: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(K,) number of the category of each instance: the first text on a tie; background if it has no feature."""
    order = np.argsort(candidates, kind="stable")
    cosine = cosines(result.feature, encoder.encode(texts))[order]
    nearest = candidates[order][np.argmax(cosine, axis=0)]  # there is at least one text
    return np.where(result.feature.any(1), nearest, BACKGROUND)


def class_means(actual: NDArray[np.int64], predicted: NDArray[np.int64]) -> tuple[float | None, float | None]:
    """Mean IoU and mean accuracy (recall) over the classes that occur in `actual`; None if there is no point."""
    numbers = np.unique(actual)
    if not len(numbers):
        return None, None
    hit = np.array([np.sum((actual == c) & (predicted == c)) for c in numbers])
    is_class = np.array([np.sum(actual == c) for c in numbers])
    called = np.array([np.sum(predicted == c) for c in numbers])
    return float(np.mean(hit / (is_class + called - hit))), float(np.mean(hit / is_class))


@dataclass(frozen=True, slots=True)
class Retrieved:
    """What one query found."""

    text: str
    type: str
    found_at: int | None
    """Place of the first acceptable instance, from 1; None: there is none."""
    answers: tuple[int, ...]
    """The three best instances."""


def retrieve(
    queries: Sequence[Query], overlaps: Overlaps, result: InstanceMap, encoder: Encoder
) -> tuple[Retrieved, ...]:
    """All instances ranked by each query; acceptable is one that overlaps an object named with IoU > 0.25."""
    iou, ids = overlaps.iou(), result.instance_id
    found = []
    for query, scores in zip(queries, likeness(result, encoder, [query.text for query in queries]), strict=True):
        ranking = ids[ranked(scores)]
        wanted = np.isin(overlaps.true_ids, query.instances)
        good = overlaps.ids[(iou[wanted] > OVERLAP).any(0)]
        hits = np.flatnonzero(np.isin(ranking, good))
        place = int(hits[0]) + 1 if len(hits) else None
        found.append(Retrieved(query.text, query.type, place, tuple(ranking[:3].tolist())))
    return tuple(found)


def recalls(found: Sequence[Retrieved]) -> Mapping[str, Mapping[str, float | int | None]]:
    """Share of queries found among the 1, 2, 3 best, by type and for all; None for a type without queries."""
    return {kind: _recall([one for one in found if kind in (one.type, "all")]) for kind in (*QUERY_TYPES, "all")}


def _recall(found: Sequence[Retrieved]) -> Mapping[str, float | int | None]:
    n = len(found)
    shares = {
        f"r{k}": sum(one.found_at is not None and one.found_at <= k for one in found) / n if n else None
        for k in (1, 2, 3)
    }
    return {**shares, "n": n}
