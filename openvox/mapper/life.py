"""The life of instances: when one is confirmed, merged into another, or split."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from openvox.core import fixedpoint
from openvox.core.mapper_parameters import FinishParameters
from openvox.core.types import Event
from openvox.mapper.codebook import Fragment, Memory, memory_of
from openvox.mapper.evidence import Evidence


def exists(memory: Memory, voxels: int, parameters: FinishParameters, frames: int) -> bool:
    """Whether enough frames matched an object (at least `frames`), of those that saw it, and it is large enough."""
    if not parameters.existence:
        return True
    share = fixedpoint.millionths(parameters.min_share)
    return (
        memory.matched >= frames
        and fixedpoint.MILLION * memory.matched >= share * memory.seen
        and voxels >= parameters.min_voxels
    )


def members_of(instance_of: Mapping[int, int]) -> dict[int, list[int]]:
    """Fragments of every instance, ascending."""
    members: dict[int, list[int]] = {}
    for f in sorted(instance_of):
        members.setdefault(instance_of[f], []).append(f)
    return members


class Life:
    """Remembers which instances were confirmed, and says what changed from frame to frame."""

    def __init__(self, parameters: FinishParameters) -> None:
        self._parameters = parameters
        self.confirmed: dict[int, int] = {}
        """Instance id to the first frame at which its existence tests held."""
        self.frame = 0
        """The last frame that was followed."""

    def follow(
        self, frame: int, evidence: Evidence, fragments: Mapping[int, Fragment], touched: Iterable[int]
    ) -> list[Event]:
        """Events of one frame, whose clusters `evidence` holds. touched: changed fragments."""
        self.frame = frame
        events = self._regrouped(frame, evidence)
        for instance in sorted({evidence.instance_of[f] for f in touched} - self.confirmed.keys()):
            memory = memory_of(fragments[f] for f in evidence.members[instance])
            if exists(memory, memory.voxels, self._parameters, self._parameters.min_frames):
                self.confirmed[instance] = frame
                text = f"matched in {memory.matched} of {memory.seen} frames that saw it, {memory.voxels} voxels"
                events.append(Event(frame, "confirmed", instance, (), text))
        return events

    def _regrouped(self, frame: int, evidence: Evidence) -> list[Event]:
        joined: dict[int, set[int]] = {}
        parted: dict[int, set[int]] = {}
        for f, old in evidence.regrouped().items():
            joined.setdefault(evidence.instance_of[f], set()).add(old)
            parted.setdefault(old, set()).add(evidence.instance_of[f])
        events = []
        for instance in sorted(joined):
            others = sorted(joined[instance] - {instance})
            if len(joined[instance]) > 1 and others:
                text = "seen together more than apart: one thing"
                events.append(Event(frame, "merged", instance, tuple(others), text))
        for old in sorted(parted):
            others = sorted(parted[old] - {old})
            if len(parted[old]) > 1 and others:
                text = "seen apart more than together: not one thing"
                events.append(Event(frame, "split", old, tuple(others), text))
        return events
