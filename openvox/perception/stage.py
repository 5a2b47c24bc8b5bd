"""What the pipeline asks of its stages: Enc( SegCap( Det(C) ) ), eq. (1) of the paper.

A stage is a plain object with a name, its parameters, a digest and one call. Its digest says all that its output
depends on besides the frame's own digest and the stage before: name and version, parameters, the bytes of its model
file, what it took from the whole recording. Calls come from several threads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from openvox.core.digest import digest_of
from openvox.core.parameters import Value
from openvox.core.types import Frame, Mask
from openvox.formats.detections import Box


class Stage(Protocol):
    """What all stages have. `model_digest`: SHA-256 of the files that it was loaded from, "" = none."""

    name: str
    parameters: Mapping[str, Value]
    model_digest: str

    def digest(self, frame: Frame) -> str:
        """SHA-256 of what the output for a frame depends on, its digest and the stage before apart."""
        ...


class Detector(Stage, Protocol):
    """Det: where something is. One that does not look at every frame has `looks_at(frame)`, see Pipeline."""

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """Boxes in colour pixels, scores, words."""
        ...


class Segmenter(Stage, Protocol):
    """SegCap: the masks of what was detected, with captions, still without embeddings."""

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """Masks in colour pixels, in the order they are numbered by."""
        ...


class Encoder(Stage, Protocol):
    """Enc: captions to vectors."""

    @property
    def dimensions(self) -> int:
        """Length of a vector; to know it the model may have to be loaded."""
        ...

    def __call__(self, frame: Frame, masks: Sequence[Mask]) -> NDArray[np.float32]:
        """(len(masks), dimensions), rows of unit length."""
        ...


def stage_digest(name: str, version: int, parameters: Mapping[str, Value], *inputs: str) -> str:
    """A stage's digest. version: raised when the same parameters come to mean another output. inputs: digests."""
    return digest_of({"stage": name, "version": version, "parameters": dict(parameters), "inputs": list(inputs)})
