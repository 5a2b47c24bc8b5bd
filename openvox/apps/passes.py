"""Passes before the last one: the same frames mapped again, with the map so far as the prior."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from typing import Any

from openvox.apps.loop import Observer, run
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.types import Frame, InstanceMap, Mask, Step
from openvox.formats.trace import decision_link
from openvox.mapper.mapper import Mapper

Frames = Callable[[], AbstractContextManager[Iterable[tuple[Frame, Sequence[Mask] | None]]]]


class Chain:
    """An observer: the trace's digest of a pass that writes no trace."""

    def __init__(self, digest: str) -> None:
        self.digest = digest

    def on_step(self, step: Step) -> None:
        """One link more."""
        self.digest = decision_link(self.digest, step.frame.index, [asdict(one) for one in step.decisions])

    def close(self, result: InstanceMap) -> None:
        """Nothing is left to do."""


def first_passes(
    passes: int, mapper: Mapper, frames: Frames, watching: Sequence[Observer], link: str
) -> tuple[list[dict[str, Any]], str, InstanceMap | None]:
    """All passes but the last: a row of each, the last link of the chain of decisions, and the map so far.

    frames: opens them anew for every pass. The mapper is ready for the last pass, which begins with the whole map."""
    rows, result = [], None
    for _ in range(passes - 1):
        chain = Chain(link)
        with frames() as items:
            run(items, mapper, [chain, *watching])
        result, link = mapper.finish(), chain.digest
        rows.append(pass_row(result, link))
        mapper.look_again()
    return rows, link, result


def pass_row(result: InstanceMap, link: str) -> dict[str, Any]:
    """What a pass gave, for comparing passes."""
    digests = {"map": map_digest(result), "trace": link}
    return {"voxels": len(result.voxel_index), "instances": len(result.instance_id), "digests": digests}


def check_passes(passes: int, resumed: bool) -> None:
    """Raises InputError where the passes make no sense."""
    if passes < 1:
        raise InputError(f"--passes is {passes}; a recording is mapped once at least")
    if passes > 1 and resumed:
        raise InputError(
            "--passes and --resume do not go together: a second pass maps all frames again, a resumed run only the "
            "rest; leave out one of the two"
        )
