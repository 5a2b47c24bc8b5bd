"""evaluate: a map against ground truth. The protocol is in docs/evaluation.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.apps.info import check_kind
from openvox.apps.ranking import Encoder
from openvox.apps.scoring.calibration import expected_calibration_error
from openvox.apps.scoring.instances import ELSEWHERE, FAR, MIN_POINTS, InstanceScore, Overlaps, score_instances
from openvox.apps.scoring.labels import labels_of_rows, rows_at_points
from openvox.apps.scoring.recording_truth import recording_truth
from openvox.apps.scoring.rendered import perception_of, score_rendered
from openvox.apps.scoring.semantics import read_classes, recalls, retrieve, score_semantics
from openvox.apps.words import encoder_of
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import read_map
from openvox.formats.truth import Truth, read_truth


def evaluate(
    map_file: Path,
    *,
    truth: Path,
    queries: Path | None = None,
    classes: Path | None = None,
    models: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Every measure of the map, by the names that docs/evaluation.md explains; None where the truth has nothing.

    truth: a folder with gt_points.npz, or a recording with truth pictures. queries: instead of the truth's
    queries.json. classes: names, one a line, instead of the truth's categories. models: as in apps.query.
    Raises InputError.
    """
    check_kind(map_file, "map")
    result = read_map(map_file)
    names = None if classes is None else read_classes(classes)
    known = read_truth(truth, queries) if truth.is_dir() else recording_truth(truth, queries)
    near, inside = rows_at_points(known.points, result), rows_at_points(known.points, result, reach=0)
    labels = labels_of_rows(near, result)
    confidence = dict(zip(result.instance_id.tolist(), result.instance_confidence.tolist(), strict=True))
    scores = score_instances(known.instance, labels, confidence)
    reached = (known.instance > 0) & (labels > 0)
    perception, no_perception = perception_of(map_file, result.meta)
    rendered = score_rendered(result, truth, perception, progress)
    encoder, no_encoder = _encoder(result, models)
    return {
        "instances": _figures(scores),
        "instances_in_voxel": _figures(score_instances(known.instance, labels_of_rows(inside, result), confidence)),
        "instances_authors_rule": _figures(score_instances(known.instance[reached], labels[reached], confidence)),
        "objects": _objects(scores, known),
        "calibration": {"ece": expected_calibration_error(known.instance, labels, _confidence(near, result))},
        "rendered_masks": None if rendered is None else asdict(rendered),
        **_words(known, labels, result, encoder, names),
        "notes": [
            *([ELSEWHERE] if scores.missed_share > FAR else []),
            *([FEWER] if scores.predicted < len(result.instances) else []),
            *([f"no detected_iou: {no_perception}"] if rendered is not None and no_perception else []),
            *([f"no semantics and retrieval: {no_encoder}"] if no_encoder else []),
            *([] if truth.is_dir() else [NOISY_TRUTH]),
        ],
    }


FEWER = (
    f"predicted counts the instances that hold at least {MIN_POINTS} true points; the map may have smaller ones, too"
)
NOISY_TRUTH = (
    "points made from a recording carry its sensor's noise and score lower; compare only figures of one kind of truth"
)


def _figures(scores: InstanceScore) -> dict[str, Any]:
    return {name: value for name, value in asdict(scores).items() if name != "objects"}


def _objects(scores: InstanceScore, truth: Truth) -> list[dict[str, Any]]:
    names = {one.id: one.name for one in truth.objects}
    return [
        {
            "id": o.id,
            "name": names.get(o.id, f"object {o.id}"),
            "best_iou": o.best_iou,
            "split_into": list(o.split_into),
            "merged_with": list(o.merged_with),
            "missed": o.missed,
            "points": o.points,
            "ignored": o.ignored,
        }
        for o in scores.objects
    ]


def _confidence(rows: NDArray[np.int64], result: InstanceMap) -> NDArray[np.float64]:
    return np.append(result.voxel_confidence, np.float32(0))[rows].astype(np.float64)


def _encoder(result: InstanceMap, models: Path | None) -> tuple[Encoder | None, str]:
    """What turns words into vectors like the map's features; else why there is none, in words."""
    try:
        return encoder_of(result, models), ""
    except InputError as error:
        return None, str(error)


def _words(
    truth: Truth, labels: NDArray[np.int64], result: InstanceMap, encoder: Encoder | None, names: tuple[str, ...] | None
) -> dict[str, Any]:
    """The measures that need an encoder."""
    if encoder is None:
        return {"semantics": None, "retrieval": None, "queries": None}
    semantics = score_semantics(truth, labels, result, encoder, names)
    found = retrieve(truth.queries, Overlaps.count(truth.instance, labels), result, encoder)
    return {
        "semantics": None if semantics is None else asdict(semantics),
        "retrieval": recalls(found) if truth.queries else None,
        "queries": [asdict(one) for one in found] if truth.queries else None,
    }
