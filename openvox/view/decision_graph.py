"""This frame's masks, instances, and what speaks for each pair, as a graph in three columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from openvox.core.colors import GREY, instance_color
from openvox.core.fixedpoint import Q20
from openvox.core.types import Decision, Step
from openvox.view.labels import shortened

CANDIDATES = 3
FAINT = Q20 // 20
"""So many candidates are shown a mask, best first, if their A is not below this; and the one that was chosen."""
LETTERS = 28
ROW, COLUMN = 26.0, 400.0
CHOSEN = (240, 240, 240)
PLAIN_RULES = ("new", "threshold", "small", "empty")
"""Where A and the threshold alone decided, or nothing was to be decided; else overlaps are shown, too."""


@dataclass
class Graph:
    """Nodes in parallel lists, edges between their ids."""

    ids: list[str] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    colors: list[tuple[int, int, int]] = field(default_factory=list)
    positions: list[tuple[float, float]] = field(default_factory=list)
    edges: list[tuple[str, str]] = field(default_factory=list)

    def add(self, name: str, label: str, color: tuple[int, int, int], column: int, row: float) -> None:
        """One node more."""
        self.ids.append(name)
        self.labels.append(label)
        self.colors.append(color)
        self.positions.append((column * COLUMN, round(row * ROW)))


def decision_graph(step: Step, caption_of: Callable[[int], str]) -> Graph:
    """Masks left, instances right, and between them one node a candidate with A, and |overlap| where another rule
    than the threshold decided; the chosen one is white."""
    graph, rows = Graph(), dict[int, list[float]]()
    row = 0.0
    for decision in step.decisions:
        labels = _weights(decision)
        mask = step.masks[decision.mask]
        caption = shortened(mask.caption or mask.label, LETTERS)
        color = instance_color(decision.instance)
        graph.add(f"m{decision.mask}", f"mask {decision.mask}: {caption}", color, 0, row + (len(labels) - 1) / 2)
        for instance, label in labels.items():
            middle = f"m{decision.mask}-{instance}"
            graph.add(middle, label, CHOSEN if instance == decision.instance else GREY, 1, row)
            graph.edges += [(f"m{decision.mask}", middle), (middle, f"i{instance}")]
            rows.setdefault(instance, []).append(row)
            row += 1.0
        row += 0.4 if labels else 1.0
    heights = sorted((sum(at) / len(at), instance) for instance, at in rows.items())
    for place, (_, instance) in enumerate(heights):
        label = f"{instance}: {shortened(caption_of(instance), LETTERS)}"
        graph.add(f"i{instance}", label, instance_color(instance), 2, place * row / len(heights))
    return graph


def _weights(decision: Decision) -> dict[int, str]:
    """Instance to what stands on its edge: the best candidates, and whom the mask went to."""
    labels = {}
    for rank, candidate in enumerate(decision.candidates):
        if (rank < CANDIDATES and candidate.a >= FAINT) or candidate.instance == decision.instance:
            overlap = "" if decision.by in PLAIN_RULES else f", {candidate.overlap} of {decision.voxels} voxels"
            labels[candidate.instance] = f"A {candidate.a / Q20:.2f}{overlap}"
    if decision.instance:
        known = labels.get(decision.instance)
        labels[decision.instance] = f"{decision.by}: {known}" if known else decision.by
    return labels
