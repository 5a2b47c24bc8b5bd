"""Which instances are worth drawing again: those that changed visibly, or have waited long enough."""

from __future__ import annotations

from openvox.view.live_map import Change, LiveMap

SHARE = 6
"""At once if one in so many of its voxels came or went since it was drawn."""
PATIENCE = 25
"""Steps after which any change is drawn."""


class Redraw:
    """Counts the voxels that came to or left each instance since it was last drawn."""

    def __init__(self) -> None:
        self._moved: dict[int, int] = {}
        self._since: dict[int, int] = {}
        self._regrouped: set[int] = set()
        self._step = 0

    def note(self, change: Change) -> None:
        """Remember what a step changed."""
        self._step += 1
        for instance, moved in change.moved.items():
            self._moved[instance] = self._moved.get(instance, 0) + moved
        for instance in (*change.moved, *change.regrouped):
            self._since.setdefault(instance, self._step)
        self._regrouped.update(change.regrouped)

    def due(self, live: LiveMap) -> list[int]:
        """Instances to draw now, ascending; they count as drawn from here on.

        One that is new, merged or split is due at once: a fragment of it came or went as a whole.
        """
        due = [
            instance
            for instance in sorted(self._since)
            if instance in self._regrouped
            or self._moved[instance] * SHARE >= live.count(instance)
            or self._step - self._since[instance] >= PATIENCE
        ]
        for instance in due:
            self._moved.pop(instance, None)
            del self._since[instance]
        self._regrouped.difference_update(due)
        return [instance for instance in due if instance > 0]

    def waiting(self) -> list[int]:
        """Instances that changed since they were drawn, ascending."""
        return [instance for instance in sorted(self._since) if instance > 0]
