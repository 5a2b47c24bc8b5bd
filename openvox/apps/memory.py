"""A cap on memory: a run that would need more ends in a sentence, before the system ends it."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

from openvox.core.errors import InputError
from openvox.core.types import InstanceMap, Step

FINISHING = 180
"""Bytes a voxel that finishing takes for a moment; measured at 169."""
GROWING = 40
"""Bytes a voxel that the map takes once more while its tables grow."""
MEGABYTE = 1_000_000


class MemoryLimit:
    """An observer that stops a run at the first frame after which the process, with what finishing takes, would need
    more than so many megabytes."""

    def __init__(self, megabytes: int) -> None:
        self._limit = megabytes

    def on_step(self, step: Step) -> None:
        """Raises InputError where the limit is reached."""
        used, more = memory_in_use(), (FINISHING + GROWING) * step.voxels
        needed = (used + more) // MEGABYTE
        if needed > self._limit:
            cure = f"choose a larger map.voxel_size, or --end {step.frame.index}"
            if more < used // 10:
                cure = "that is the program more than the map: allow more"
            raise InputError(
                f"frame {step.frame.index}: {needed} MB are needed to finish the map of {step.voxels} "
                f"voxels, --max-memory is {self._limit}; {cure}"
            )

    def close(self, result: InstanceMap) -> None:
        """Nothing is left to do."""


def memory_in_use() -> int:
    """Bytes of the process in memory; the most so far where the system does not tell."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
    except (OSError, IndexError, ValueError):
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if sys.platform == "darwin" else most * 1024
