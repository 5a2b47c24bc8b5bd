"""The one loop: replay, live runs and tests all come through here."""

from __future__ import annotations

import gc
from collections.abc import Iterable, Sequence
from typing import Protocol

from openvox.core.types import Frame, InstanceMap, Mask, Step


class Stepping(Protocol):
    """A mapper, or what stands before one."""

    def step(self, frame: Frame, masks: Sequence[Mask] | None) -> Step:
        """See Mapper.step."""
        ...


class Observer(Protocol):
    """Watches a run. Steps are frozen: watching cannot change a decision."""

    def on_step(self, step: Step) -> None:
        """One frame was mapped."""

    def close(self, result: InstanceMap) -> None:
        """The run is over, and this is its map."""


def run(
    frames: Iterable[tuple[Frame, Sequence[Mask] | None]], mapper: Stepping, observers: Sequence[Observer] = ()
) -> None:
    """Map frames in the order of their stamps; masks are None where perception did not look."""
    gc.freeze()  # looking through all that is loaded for garbage would take longer than some frames
    try:
        for frame, masks in frames:
            step = mapper.step(frame, masks)
            for observer in observers:
                observer.on_step(step)
    finally:
        gc.unfreeze()
