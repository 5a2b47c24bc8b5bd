"""All instances as a table for people: captions and their votes, observations, how sure the voxels are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.view.decision_table import escaped
from openvox.view.labels import caption_votes

HEAD = "| id | observations | voxels | confidence, 0 to 1 | captions (votes) |"
RULE = "|---:|---:|---:|:---|:---|"
BARS = " ▁▂▃▄▅▆▇█"
BINS = 10


@dataclass(frozen=True, eq=False)
class Row:
    """One instance. histogram: voxels by confidence, ten equal bins."""

    instance: int
    captions: Sequence[tuple[str, float]]
    observations: int
    histogram: NDArray[np.int64]


def histogram(confidence: NDArray[np.float32]) -> NDArray[np.int64]:
    """Voxels by confidence in ten equal bins, (10,)."""
    return np.bincount(np.minimum((confidence * BINS).astype(np.int64), BINS - 1), minlength=BINS)


def markdown(rows: Sequence[Row]) -> str:
    """A table, one row an instance."""
    return "\n".join([f"### {len(rows)} instances\n", HEAD, RULE, *(_row(row) for row in rows)]) + "\n"


def _row(row: Row) -> str:
    captions = escaped("; ".join(caption_votes(row.captions)))
    most = max(int(row.histogram.max(initial=0)), 1)
    bars = "".join(BARS[-(-int(count) * (len(BARS) - 1) // most)] for count in row.histogram)
    cells = (row.instance, row.observations, int(row.histogram.sum()), f"`{bars}`", captions)
    return f"| {' | '.join(map(str, cells))} |"
