"""The front end of someone who knows: the recording's ground truth as masks, each whole and rightly named,
unless faults are asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from openvox.core.digest import START, chain, digest_of
from openvox.core.parameters import Value
from openvox.core.types import Frame, Mask
from openvox.formats.detections import Box
from openvox.perception.faults import Faults
from openvox.perception.parameters import OracleParameters
from openvox.perception.stage import stage_digest

VERSION = 2


class _Oracle:
    """What both stages share. categories: names of the truth's category ids."""

    name = "oracle"
    model_digest = ""

    def __init__(self, parameters: OracleParameters, categories: Mapping[int, str]) -> None:
        self._of_truth = parameters
        self._categories = categories
        self.parameters: Mapping[str, Value] = {
            f"oracle.{name}": value for name, value in dataclasses.asdict(parameters).items()
        }
        names = digest_of(sorted((number, name) for number, name in categories.items()))
        self._digest = stage_digest(self.name, VERSION, self.parameters, names)

    def digest(self, frame: Frame) -> str:
        """With the truth of the frame, which its own digest leaves out, and its number, by which faults come and go."""
        images = (frame.truth_instances, frame.truth_categories)
        parts = (b"" if image is None else np.ascontiguousarray(image, "<u2").tobytes() for image in images)
        return chain(START, self._digest.encode(), *parts, str(frame.index).encode())

    def _masks(self, frame: Frame) -> tuple[Mask, ...]:
        """One mask for each instance of enough pixels, by id ascending, with the faults that the parameters ask for."""
        if frame.truth_instances is None:
            return ()
        pixels = np.bincount(frame.truth_instances.reshape(-1))
        visible = [int(number) for number in np.flatnonzero(pixels >= self._of_truth.min_pixels) if number]
        things = {number: frame.truth_instances == number for number in visible}
        return tuple(self._mask(frame, bitmap) for bitmap in Faults(self._of_truth, frame.index).masks(things))

    def _mask(self, frame: Frame, bitmap: np.ndarray[tuple[int, int], np.dtype[np.bool_]]) -> Mask:
        label = ""
        if frame.truth_categories is not None:
            # Most pixels decide, the lowest number among equals.
            number = int(np.bincount(frame.truth_categories[bitmap]).argmax())
            label = self._categories.get(number, "").replace("_", " ")
        caption = f"{'an' if label[:1] in tuple('aeiou') else 'a'} {label}" if label else "an object"
        return Mask.from_bitmap(bitmap, label=label or "object", caption=caption, named=bool(label))


class OracleBoxes(_Oracle):
    """Det: the boxes of what the truth sees."""

    def looks_at(self, frame: Frame) -> bool:
        """True if the frame has truth."""
        return frame.truth_instances is not None

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """One for each mask, in their order."""
        return tuple(
            Box((float(x0), float(y0), float(x1), float(y1)), mask.score, mask.label)
            for mask in self._masks(frame)
            for x0, y0, x1, y1 in [mask.box]
        )


class OracleMasks(_Oracle):
    """SegCap: the masks of the truth, captioned "a chair"."""

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """One for each instance, by id ascending; the boxes are those of the same truth."""
        return self._masks(frame)
