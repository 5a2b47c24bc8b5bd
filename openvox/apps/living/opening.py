"""What a live run can be fed with."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from openvox.apps.living.intake import CAPACITY, CAPACITY_SEEN_NOW
from openvox.apps.living.looking import Eyes, LiveFrontend, cached, front_end
from openvox.apps.replay import stem_of
from openvox.core.errors import InputError
from openvox.core.types import Frame
from openvox.formats.growing import final_name, finished_or_not
from openvox.formats.perception import SUFFIX as PERCEPTION_SUFFIX
from openvox.formats.recording import following, read_frames, recording_info, selected
from openvox.sources.paced import paced
from openvox.sources.source import Dropped, Options

LOOK_AGAIN = 0.05
"""Seconds between two looks at the end of a file that is still written."""
IDLE = 10.0
"""Seconds after which a file that did not grow counts as ended."""


@dataclass(frozen=True, eq=False)
class Stream:
    """Frames as they come, and what the recording is to say of their source."""

    kind: str
    depth_unit: str
    categories: Mapping[int, str]
    frames: Iterable[Frame | Dropped]
    eyes: Eyes
    stem: Path
    """Of the files to write, if nobody chose one."""
    inputs: tuple[Path, ...]
    notes: tuple[str, ...] = ()
    waiting: int = CAPACITY_SEEN_NOW
    """Frames that may wait, if nobody chose."""


def open_recording(
    path: Path,
    *,
    rate: float,
    follow: bool,
    perception: Path | None,
    frontend: LiveFrontend | None,
    chosen: tuple[int | None, int | None, int],
    stop: threading.Event,
    decoded: Callable[[float], None],
) -> Stream:
    """A recording at its own pace times `rate`; follow: one that is still written, as it grows.

    chosen: start, end, stride. decoded: told the seconds that each frame took. Raises InputError."""
    if perception is not None and frontend is not None:
        raise InputError(f"--perception {perception} and --frontend {frontend}: masks come from one of them")
    beside = finished_or_not(final_name(path).with_suffix(PERCEPTION_SUFFIX))
    masks = perception or (beside if frontend is None and beside.exists() else None)
    stem = stem_of(path)
    stem = stem.with_name(f"{stem.name}-live")
    inputs = (path, *([masks] if masks else []))
    waiting = CAPACITY if masks else CAPACITY_SEEN_NOW
    if follow:
        frames = _until(stop, _chosen(following(finished_or_not(path), _patient(stop)), *chosen))
        eyes = cached(masks) if masks else front_end(frontend or "offline")
        return Stream("live", "mm", {}, frames, eyes, stem, inputs, waiting=waiting)
    info = recording_info(path)
    start, end, stride = chosen
    recorded = read_frames(path, start=start, end=end, stride=stride, ahead=0)
    frames = paced(_timed(recorded, decoded), rate, stop)
    eyes = cached(masks) if masks else front_end(frontend or "offline")
    return Stream(info.source, info.depth_unit, info.categories, frames, eyes, stem, inputs, waiting=waiting)


def open_server(
    url: str, *, perception: Path | None, frontend: LiveFrontend | None, options: Options, stop: threading.Event
) -> Stream:
    """A Foxglove WebSocket server: what it sends until it goes, or `stop` is set. Raises InputError."""
    if perception is not None:
        raise InputError(f"--perception {perception}: frames that nobody has seen before have none; leave it out")
    from openvox.sources.foxglove_stream import read

    eyes = front_end(frontend or "offline")
    source = read(url, options, stop)
    return Stream(source.kind, source.depth_unit, {}, source.frames, eyes, Path("live"), (), source.notes)


def _chosen(frames: Iterator[Frame], start: int | None, end: int | None, stride: int) -> Iterator[Frame]:
    for frame in frames:
        if end is not None and frame.index >= end:
            return
        if selected(frame.index, start, end, stride):
            yield frame


def _until(stop: threading.Event, frames: Iterator[Frame]) -> Iterator[Frame]:
    for frame in frames:
        if stop.is_set():
            return
        yield frame


def _patient(stop: threading.Event) -> Callable[[], bool]:
    """Looks again until nothing has come for long, or the run is stopped."""
    last_look = begun = time.monotonic()

    def wait() -> bool:
        nonlocal last_look, begun
        now = time.monotonic()
        if now - last_look > 4 * LOOK_AGAIN:  # something was read meanwhile
            begun = now
        if now - begun > IDLE or stop.wait(LOOK_AGAIN):
            return False
        last_look = time.monotonic()
        return True

    return wait


def _timed(frames: Iterator[Frame], decoded: Callable[[float], None]) -> Iterator[Frame]:
    while True:
        begin = time.perf_counter()
        frame = next(frames, None)
        if frame is None:
            return
        decoded(time.perf_counter() - begin)
        yield frame
