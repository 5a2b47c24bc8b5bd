"""Enc for front ends that give words: each mask's caption through a sentence encoder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from openvox.core.parameters import Value
from openvox.core.types import Frame, Mask
from openvox.perception.stage import stage_digest

VERSION = 1


class Texts(Protocol):
    """A sentence encoder."""

    name: str
    model_digest: str

    @property
    def dimensions(self) -> int:
        """Length of a vector; to know it the model may have to be loaded."""
        ...

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """(n, dimensions), rows of unit length."""
        ...


class CaptionEncoder:
    """A sentence encoder as a stage. `texts`: the encoder. parameters: what else its vectors depend on."""

    def __init__(self, encoder: Texts, parameters: Mapping[str, Value] | None = None) -> None:
        self.texts = encoder
        self.name = encoder.name
        self.model_digest = encoder.model_digest
        self.parameters: Mapping[str, Value] = parameters or {}
        self._digest = stage_digest(self.name, VERSION, self.parameters, self.model_digest)

    @property
    def dimensions(self) -> int:
        """Of the encoder."""
        return self.texts.dimensions

    @property
    def device(self) -> str:
        """What the encoder runs on."""
        return getattr(self.texts, "device", "CPU")

    def prepare(self) -> None:
        """Has the encoder loaded."""
        self.texts.encode(["a cup"])

    def digest(self, frame: Frame) -> str:
        """The model's, for every frame."""
        return self._digest

    def __call__(self, frame: Frame, masks: Sequence[Mask]) -> NDArray[np.float32]:
        """(len(masks), dimensions); a mask without a caption is known by its label."""
        return self.texts.encode([mask.caption or mask.label for mask in masks])
