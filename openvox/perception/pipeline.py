"""The three stages over the frames of a recording, each done once: what an earlier file holds is taken from it."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Collection, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

from openvox.core.digest import digest_of, frame_digest
from openvox.core.types import Frame, Mask
from openvox.formats.perception import FrameMasks
from openvox.perception.stage import Detector, Encoder, Segmenter, Stage

Done = tuple[FrameMasks, tuple[str, ...]]
"""What was found in a frame, and the roles whose output was not there already."""
IN_FLIGHT = 2
"""Frames a worker may be ahead: enough that none waits, and memory does not grow."""


ROLES = ("det", "segcap", "enc")


@dataclass(frozen=True)
class Pipeline:
    """Det, SegCap and Enc."""

    det: Detector
    segcap: Segmenter
    enc: Encoder
    _ready: set[str] = field(default_factory=set, init=False, repr=False, compare=False)
    _lock: Lock = field(default_factory=Lock, init=False, repr=False, compare=False)

    def described(self) -> list[dict[str, Any]]:
        """Role, name, parameters and model of each stage, as a perception file notes them."""
        stages: tuple[tuple[str, Stage], ...] = (("det", self.det), ("segcap", self.segcap), ("enc", self.enc))
        return [
            {
                "role": role,
                "name": stage.name,
                "parameters": dict(stage.parameters),
                "model_digest": stage.model_digest,
            }
            for role, stage in stages
        ]

    def ready(self, role: str) -> Any:
        """The stage, its model loaded when it is asked for first: one that has nothing to do loads none.

        Raises InputError if the model does not fit."""
        stage = getattr(self, role)
        with self._lock:
            if role not in self._ready:
                getattr(stage, "prepare", lambda: None)()
                self._ready.add(role)
        return stage

    def looks_at(self, frame: Frame) -> bool:
        """False: the frame gets no message, as not looked at. Detectors that have nothing to say look at every one."""
        return bool(getattr(self.det, "looks_at", lambda _: True)(frame))

    def device(self, ran: Collection[str] = ROLES) -> str:
        """What the stages that ran did it on, in a few words; "" if none ran that has a model."""
        placed = {role: str(getattr(getattr(self, role), "device", "CPU")) for role in ROLES if role in ran}
        devices = {role: device for role, device in placed.items() if device}
        found = [f"{role} on the GPU ({device})" for role, device in devices.items() if device != "CPU"]
        rest = "the rest on the CPU" if found else "on the CPU"
        return ", ".join([*found, *([rest] if len(found) < len(devices) else [])])

    def keys(self, frame: Frame) -> tuple[str, str, str]:
        """What each stage's output depends on besides the frame's digest, the stage before included."""
        det = digest_of(["det", self.det.digest(frame)])
        segcap = digest_of(["segcap", det, self.segcap.digest(frame)])
        return det, segcap, digest_of(["enc", segcap, self.enc.digest(frame)])


def perceive_frame(pipeline: Pipeline, frame: Frame, earlier: Sequence[FrameMasks] = ()) -> Done:
    """Enc( SegCap( Det(C) ) ), eq. (1): a frame's masks, captions and embeddings.

    earlier: what other runs found in the frame of that number. A stage's output is taken from there if it was made of
    the same frame, by the same stages up to it."""
    digest, keys = frame_digest(frame), pipeline.keys(frame)
    known = [found for found in earlier if found.frame_digest == digest]
    det, segcap, enc = (_made_by(known, keys[:stages]) for stages in (1, 2, 3))
    boxes = det.boxes if det else pipeline.ready("det")(frame)
    masks = segcap.masks if segcap else pipeline.ready("segcap")(frame, boxes)
    masks = enc.masks if enc else _with_embeddings(masks, pipeline.ready("enc")(frame, masks))
    size = (frame.rig.color.height, frame.rig.color.width)
    ran = tuple(role for role, found in zip(ROLES, (det, segcap, enc), strict=True) if found is None)
    return FrameMasks(frame.index, frame.stamp_ns, digest, masks, size, boxes, keys), ran


def _made_by(known: Sequence[FrameMasks], keys: tuple[str, ...]) -> FrameMasks | None:
    """The first that the same stages made, as far as they are named."""
    return next((found for found in known if found.stage_digests[: len(keys)] == keys), None)


def _with_embeddings(masks: Sequence[Mask], vectors: Any) -> tuple[Mask, ...]:
    return tuple(dataclasses.replace(mask, embedding=vector) for mask, vector in zip(masks, vectors, strict=True))


def perceive_frames(
    pipeline: Pipeline, frames: Iterable[Frame], earlier: Sequence[Iterator[FrameMasks]] = (), jobs: int = 1
) -> Generator[tuple[Frame, Done | None], None, None]:
    """Every frame with what was found in it (see perceive_frame), None where it is not to be looked at; in order.

    earlier: frames of other runs, ascending. jobs: threads that work on frames; the result is the same."""
    before = [Shelf(found) for found in earlier]
    waiting: deque[tuple[Frame, Future[Done] | None]] = deque()
    with ThreadPoolExecutor(jobs, "openvox perceive") as pool:
        try:
            for frame in frames:
                task = None
                if pipeline.looks_at(frame):
                    kept = [found for shelf in before if (found := shelf.at(frame.index)) is not None]
                    task = pool.submit(perceive_frame, pipeline, frame, kept)
                waiting.append((frame, task))
                while len(waiting) > jobs * IN_FLIGHT:
                    yield _next_done(waiting)
            while waiting:
                yield _next_done(waiting)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _next_done(
    waiting: deque[tuple[Frame, Future[Done] | None]],
) -> tuple[Frame, Done | None]:
    frame, task = waiting.popleft()
    return frame, None if task is None else task.result()


class Shelf:
    """Frames found earlier, ascending, asked for by rising number."""

    def __init__(self, found: Iterator[FrameMasks]) -> None:
        self._found = found
        self._next = next(found, None)

    def at(self, index: int) -> FrameMasks | None:
        """The frame of that number, None if it is not there."""
        while self._next is not None and self._next.index < index:
            self._next = next(self._found, None)
        return self._next if self._next is not None and self._next.index == index else None
