"""The front end of the user: boxes, masks, captions and perhaps embeddings from a file of detections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from openvox.core.parameters import Value
from openvox.core.types import Frame, Mask
from openvox.formats.detections import Box, DetectionFile, FrameDetections
from openvox.perception.stage import stage_digest

VERSION = 1


class _Given:
    """What all three stages share: the file, whose bytes enter every key."""

    name = "detections"
    device = ""
    """No model is run."""

    def __init__(self, file: DetectionFile) -> None:
        self._file = file
        self._numbers = frozenset(file.frames)
        self.parameters: Mapping[str, Value] = {}
        self.model_digest = file.digest
        self._digest = stage_digest(self.name, VERSION, self.parameters, file.digest)

    def digest(self, frame: Frame) -> str:
        """With the frame's number, which is all that the file knows of it."""
        return f"{self._digest}:{frame.index}"

    def _read(self, frame: Frame) -> FrameDetections:
        camera = frame.rig.color
        return self._file.read(frame.index, (camera.height, camera.width))


class GivenBoxes(_Given):
    """Det: the boxes of the file."""

    def looks_at(self, frame: Frame) -> bool:
        """True if the file has a line for the frame."""
        return frame.index in self._numbers

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """In the order of the file. Raises InputError."""
        return self._read(frame).boxes


class GivenMasks(_Given):
    """SegCap: the masks and captions of the file."""

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """In the order of the file. Raises InputError."""
        return self._read(frame).masks


class GivenEmbeddings(_Given):
    """Enc: the file's own embeddings; the stage is named after their encoder."""

    def __init__(self, file: DetectionFile) -> None:
        super().__init__(file)
        self.name = file.encoder
        self.dimensions = file.dimensions

    def __call__(self, frame: Frame, masks: Sequence[Mask]) -> NDArray[np.float32]:
        """(len(masks), dimensions). Raises InputError."""
        vectors = [mask.embedding for mask in self._read(frame).masks if mask.embedding is not None]
        return np.array(vectors, np.float32).reshape(len(masks), self.dimensions)
