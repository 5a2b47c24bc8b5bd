"""A mapper that others may ask for its map while it maps."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from openvox.core.errors import OutputError
from openvox.core.types import Frame, InstanceMap, Mask, Step
from openvox.formats.map_npz import write_map
from openvox.mapper.mapper import Mapper

SNAPSHOT_SECONDS = 10.0


class SharedMap:
    """`step` for the one thread that maps, `finish` for any other; mapping waits only while the map is copied."""

    def __init__(self, mapper: Mapper, meta: dict[str, Any]) -> None:
        self._mapper, self._meta = mapper, meta
        self._lock, self._turn, self._asking = threading.Lock(), threading.Lock(), threading.Lock()
        self._steps, self._last = 0, -1
        self._finished: tuple[int, InstanceMap] | None = None

    def step(self, frame: Frame, masks: Sequence[Mask] | None) -> Step:
        """As the mapper's."""
        with self._turn:  # held by whoever asks, so that a busy mapper lets him in
            pass
        with self._lock:
            step = self._mapper.step(frame, masks)
            self._steps, self._last = self._steps + 1, frame.index
            return step

    def finish(self) -> InstanceMap:
        """The map as it stands; made once for every frame, however many ask. Its meta say after how many frames."""
        with self._asking:
            with self._turn, self._lock:
                if self._finished is not None and self._finished[0] == self._steps:
                    return self._finished[1]
                steps, last, make = self._steps, self._last, self._mapper.frozen()
            made = replace(make(), meta={**self._meta, "frames": steps, "last": last})
            self._finished = steps, made
            return made


class Snapshots:
    """A thread that writes the map every few seconds to `path`, for who wants to read it while it grows."""

    def __init__(self, shared: SharedMap, path: Path, seconds: float = SNAPSHOT_SECONDS) -> None:
        self._shared, self._path, self._seconds = shared, path, seconds
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="openvox snapshots", daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._stop.wait(self._seconds):
            try:
                write_map(self._path, self._shared.finish())
            except OutputError:  # of a full disk the recording tells sooner
                return
