"""Truth out of a recording: surface points of its depth with the ids and categories of its truth pictures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.formats.recording import read_frames, recording_info
from openvox.formats.truth import TrueObject, Truth, read_queries


def recording_truth(path: Path, queries: Path | None, progress: Callable[[int, int], None] | None = None) -> Truth:
    """Points, objects and categories of a recording with truth pictures, frame by frame. Raises InputError."""
    from openvox.apps.scoring.surface import Surface  # compiled code

    info = recording_info(path)
    if not info.has_truth:
        raise InputError(f"{path} has no ground truth; name a folder with gt_points.npz, or a recording with truth")
    surface = Surface()
    with closing(read_frames(path)) as frames:
        for done, frame in enumerate(frames, 1):
            surface.add(frame)
            if progress is not None:
                progress(done, info.frames)
    points, instance, category = surface.result()
    if not len(points):
        raise InputError(f"{path} has no depth under its truth pictures; there is nothing to score against")
    return Truth(
        points=points,
        instance=instance,
        category=category if info.categories else None,
        objects=_objects(instance, category, info.categories),
        queries=() if queries is None else read_queries(queries),
        categories=dict(sorted(info.categories.items())),
    )


def _objects(
    instance: NDArray[np.int64], category: NDArray[np.int64], names: Mapping[int, str]
) -> tuple[TrueObject, ...]:
    """Every instance with points, named by the category of most of them (the lowest number on a tie) and its id."""
    objects = []
    for number in np.unique(instance[instance > 0]).tolist():
        kind = int(np.argmax(np.bincount(category[instance == number])))
        objects.append(TrueObject(number, f"{names.get(kind, 'object')} {number}"))
    return tuple(objects)
