"""What a trace tells of a run: rules, margins, and how the map grew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from openvox.core.fixedpoint import Q20
from openvox.core.types import InstanceMap
from openvox.formats.trace import TraceFrame
from openvox.view.page.document import Html, tag
from openvox.view.page.plots import bars, histogram, lines


@dataclass
class Run:
    """Counts over the frames of a trace; lists have one entry a frame, margins one a decision with a candidate."""

    frames: list[int] = field(default_factory=list)
    voxels: list[int] = field(default_factory=list)
    instances: list[int] = field(default_factory=list)
    confirmed: list[int] = field(default_factory=list)
    masks: list[int] = field(default_factory=list)
    rules: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    above_threshold: list[float] = field(default_factory=list)
    """Best A minus threshold."""
    above_second: list[float] = field(default_factory=list)
    """Best A minus second best; decisions with two candidates."""
    not_looked: int = 0


def counted(frames: Sequence[TraceFrame], confirmed: Iterable[int] = ()) -> Run:
    """Counts over the frames of a trace. confirmed: instances that were confirmed before the first of them."""
    run, instance_of, sure = Run(), dict[int, int](), set(confirmed)
    for frame in frames:
        _count(run, frame)
        instance_of.update(frame.regrouped)
        sure.update(event.instance for event in frame.events if event.kind == "confirmed")
        alive = set(instance_of.values()) - {0}
        run.instances.append(len(alive))
        run.confirmed.append(len(alive & sure))
    return run


def confirmed_before(frames: Sequence[TraceFrame], result: InstanceMap) -> set[int]:
    """Instances of the map that the run went on from which were confirmed, as far as they live on in its result."""
    if not frames:
        return set()
    born = {event.instance for event in frames[0].events if event.kind == "new"}
    told = {event.instance for frame in frames for event in frame.events if event.kind == "confirmed"}
    brought = {instance for _, instance in frames[0].regrouped} - born - told
    return brought & {summary.id for summary in result.instances if summary.state == "confirmed"}


def _count(run: Run, frame: TraceFrame) -> None:
    run.frames.append(frame.frame)
    run.voxels.append(frame.changes.first_new + len(frame.changes.new_index))
    run.masks.append(len(frame.decisions))
    run.not_looked += not frame.looked
    run.rules.update(str(decision["by"]) for decision in frame.decisions)
    run.events.update(event.kind for event in frame.events)
    for decision in frame.decisions:
        _margins(run, decision)


def _margins(run: Run, decision: Mapping[str, Any]) -> None:
    best = sorted((candidate["a"] for candidate in decision["candidates"]), reverse=True)[:2]
    if best:
        run.above_threshold.append((best[0] - decision["threshold"]) / Q20)
    if len(best) > 1:
        run.above_second.append((best[0] - best[1]) / Q20)


EVENTS = ("new", "confirmed", "merged", "split", "cut", "dropped")


def run_section(run: Run) -> list[Html]:
    """Decisions and growth as plots."""
    rules = sorted(run.rules.items(), key=lambda item: (-item[1], item[0]))
    events = [(kind, run.events[kind]) for kind in EVENTS]
    decisions = (
        bars("Decisions by rule", rules, "which rule sent a mask to its instance"),
        bars("Events", events, "in the lives of instances"),
        histogram("Best A minus threshold", run.above_threshold, -1, 1, "below 0 the threshold says: a new instance"),
        histogram("Best A minus second best", run.above_second, 0, 1, "near 0 another instance was almost as good"),
    )
    grown = [("all", run.instances), ("confirmed", run.confirmed)]
    growth = (
        lines("Voxels", run.frames, [("voxels", run.voxels)], "of the map, by frame"),
        lines("Instances", run.frames, grown, "before finishing drops the weak ones"),
        lines("Masks", run.frames, [("masks", run.masks)], "in each frame"),
    )
    skipped = f" Perception did not look at {run.not_looked} of them." if run.not_looked else ""
    return [
        tag("h2", "Decisions"),
        tag("p", f"{sum(run.rules.values())} masks in {len(run.frames)} frames.{skipped}", class_="note"),
        tag("div", decisions, class_="plots"),
        tag("h2", "Growth"),
        tag("div", growth, class_="plots"),
    ]
