"""The state of every instance from its first frame on: tentative, confirmed, merged, split off, dropped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from openvox.core.types import Event, InstanceMap, Step

STATES = {
    "tentative": (120, 144, 156),
    "confirmed": (67, 160, 71),
    "split": (251, 140, 0),
    "merged": (126, 87, 194),
    "dropped": (229, 57, 53),
}
"""Each state and its colour. merged: into another instance; split: off another one, not confirmed since."""
FATE = "{}, dropped at the end"
FATE_COLOR = (156, 60, 60)
"""Finishing drops after the last frame, where a lane has no width left: its last stretch says so."""
COLORS = {**STATES, **{FATE.format(state): FATE_COLOR for state in STATES}}


class Lives:
    """Remembers who is alive and who was ever confirmed."""

    def __init__(self, earlier: InstanceMap | None = None) -> None:
        self._confirmed = {s.id for s in earlier.instances if s.state == "confirmed"} if earlier else set[int]()
        self._unborn = earlier is not None
        self._instance_of: Mapping[int, int] = {}
        self._alive: set[int] = set()

    def changes(self, step: Step) -> list[tuple[int, str]]:
        """Instances whose state is another after this step, ascending, and the state; at the end those dropped."""
        out: dict[int, str] = {}
        if step.instance_of != self._instance_of:
            born = {event.instance for event in step.events if event.kind == "new"}
            self._instance_of = dict(step.instance_of)
            now = set(self._instance_of.values())
            out.update({instance: self._arrived(instance, born) for instance in now - self._alive})
            out.update(dict.fromkeys(self._alive - now, "merged"))
            self._alive = now
        self._unborn = False
        for event in step.events:
            if event.kind == "confirmed":
                out[event.instance] = "confirmed"
                self._confirmed.add(event.instance)
        return [*sorted(out.items()), *dropped(step.events)]

    def _arrived(self, instance: int, born: Iterable[int]) -> str:
        if instance in self._confirmed:
            return "confirmed"
        return "tentative" if instance in born or self._unborn else "split"


def dropped(events: Sequence[Event]) -> list[tuple[int, str]]:
    """What finishing dropped, which a trace tells at its last step."""
    return [(event.instance, event.kind) for event in events if event.kind == "dropped"]
