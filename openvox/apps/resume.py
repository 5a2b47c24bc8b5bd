"""Going on where an earlier run stopped: its map, its trace's chain, and whether this run is of the same kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.digest import START, map_digest
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import MapperParameters
from openvox.core.parameters import as_dict
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import read_map
from openvox.formats.perception import PerceptionInfo
from openvox.formats.recording import RecordingInfo

CHAIN = "trace"
"""Name of the state array that holds the last link of the trace's chain."""


@dataclass(frozen=True, eq=False)
class Beginning:
    """What a run begins with: nothing, or the map of an earlier one."""

    map: InstanceMap | None = None
    chain: str = START
    frames: int = 0
    """Frames that were mapped before."""
    last: int | None = None
    """The last of them, if they are of the same recording."""
    path: Path | None = None

    @property
    def said(self) -> dict[str, Any]:
        """What map and trace say of the earlier runs, the first one first."""
        if self.map is None:
            return {}
        meta = self.map.meta
        names = ("recording", "frames", "digests")
        return {"resumed": [*meta.get("resumed", []), {name: meta.get(name) for name in names}]}

    def first_frame(
        self, start: int | None, stride: int, source: RecordingInfo, notice: Callable[[str], None]
    ) -> int | None:
        """Where to begin: in the same recording one stride behind the last frame. notice: told which frames are left
        out. Raises InputError."""
        if self.last is None:
            return start
        if start is not None and start <= self.last:
            raise InputError(
                f"{self.path} has this recording's frames up to {self.last} already; leave --start out to go on there"
            )
        if self.last >= source.last:
            raise InputError(
                f"{self.path} has mapped {source.path} to its last frame, {self.last}; there is nothing to go on with"
            )
        if start is not None and start > self.last + stride:
            notice(
                f"frames {self.last + 1} to {start - 1} are left out: the map will not be that of a run without a break"
            )
        return self.last + stride if start is None else start


def chain_state(link: str) -> dict[str, NDArray[np.uint8]]:
    """The last link of the trace's chain as an array of the map's state."""
    return {CHAIN: np.frombuffer(bytes.fromhex(link), np.uint8)}


def beginning(
    path: Path | None, preset: str, parameters: MapperParameters, found: PerceptionInfo, source: RecordingInfo
) -> Beginning:
    """The map to go on from, held against what this run is to be; nothing if path is None. Raises InputError."""
    if path is None:
        return Beginning()
    earlier = read_map(path)
    meta = earlier.meta
    _check_same_run(path, meta, preset, parameters, found)
    digests, link = meta.get("digests"), earlier.state.get(CHAIN)
    if not isinstance(digests, dict) or link is None or link.dtype != np.uint8 or link.shape != (32,):
        raise InputError(f"{path} holds no state to resume from; replay from the beginning")
    if digests.get("map") != map_digest(earlier):
        raise InputError(f"{path} is not as it was written: its digest is another; replay from the beginning")
    frames, last = meta.get("frames"), meta.get("last")
    same = digests.get("recording") == source.digest
    return Beginning(
        earlier,
        link.tobytes().hex(),
        frames if isinstance(frames, int) else 0,
        last if same and isinstance(last, int) else None,
        path,
    )


def _check_same_run(
    path: Path, meta: Mapping[str, Any], preset: str, parameters: MapperParameters, found: PerceptionInfo
) -> None:
    if meta.get("preset") != preset:
        raise InputError(f"{path} was mapped with preset {meta.get('preset')}, this run has {preset}; choose the same")
    before, now = meta.get("parameters"), as_dict(parameters)
    before = before if isinstance(before, dict) else {}
    for name in sorted(now):
        if name not in before:
            raise InputError(f"{path} is of another version of openvox, without {name}; replay from the beginning")
        if before[name] != now[name]:
            raise InputError(
                f"{path} was mapped with {name} = {before[name]}, this run has {now[name]}; "
                "resume with the same parameters, or replay from the beginning"
            )
    if meta.get("encoder") != found.encoder:
        raise InputError(
            f"{path} was mapped with captions encoded by {meta.get('encoder') or 'nothing'}, {found.path} has "
            f"{found.encoder or 'none'}; run perceive with the same encoder"
        )
