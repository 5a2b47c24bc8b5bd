"""SegCap of the front end that comes with openvox: regions from depth, parted and joined, named where that is sure.

Depth gives regions; height above a top and colour on even ground part what depth alone leaves in one (kind `support`);
a detector's boxes join pieces into things (kind `object`). Words come from the detector and, for what it did not name,
from a classifier; both only where they are mostly right. The rest keeps an honest caption without a noun.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.core.digest import digest_of
from openvox.core.parameters import Value
from openvox.core.phrases import COLORS
from openvox.core.types import Frame, Intrinsics, Mask, MaskKind
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.perception.claims import Thing, claims
from openvox.perception.det.boxes import box_iou
from openvox.perception.geometry import SCORE
from openvox.perception.namer import Namer
from openvox.perception.parameters import GeometryParameters, OfflineParameters
from openvox.perception.parts import Parts, parted
from openvox.perception.planes import Room
from openvox.perception.sizes import extent_of, fits
from openvox.perception.stage import stage_digest
from openvox.perception.surface import working_step
from openvox.perception.wording import Form, color_of, color_words

AGREE = 0.5
"""IoU of a mask's box with the detector's: below it the word may be about something else."""
NO_FORM = Form("", "object", "")
Word = tuple[str, float]
"""A noun, "" = none, and how sure it is."""
UNSURE = 0.5
"""What the classifier's other nouns count beside a given word."""
WHOLE, SMALL, CUT_OFF = 0.6, 0.3, 0.2
"""Scores of masks that a detector found, of small nameless regions, and of those that the picture's edge cuts."""
GUESS = 0.1
"""What a guess from the form alone counts: too little for a name."""
PICTURE_SIZE = 0.12, 1.6
"""Metres: larger ones are windows and doors."""
BOX_SIZE = 0.12, 0.6
"""Metres: what stands somewhere and is no larger may be put there, as boxes are."""
EVERYDAY = {
    "couch": "sofa",
    "tv": "television",
    "remote": "remote control",
    "cell phone": "mobile phone",
    "mouse": "computer mouse",
    "hair drier": "hair dryer",
    "sports ball": "ball",
}
"""The detector's words for what the classifier calls otherwise: votes for one thing must not be parted."""
VERSION = 10


@dataclass(frozen=True, slots=True)
class Words:
    """What a mask is called, and what else it may be."""

    word: Word = ("", SCORE)
    others: tuple[Word, ...] = ()


class Offline:
    """Regions, boxes and words to masks with captions. Takes the room's planes from the whole recording."""

    name = "offline"

    def __init__(self, geometry: GeometryParameters, offline: OfflineParameters, room: Room) -> None:
        self._geometry, self._offline, self._room = geometry, offline, room
        self._namer = Namer()
        self.model_digest = self._namer.digest
        self.parameters: Mapping[str, Value] = {
            **{f"geometry.{name}": value for name, value in dataclasses.asdict(geometry).items()},
            **{f"offline.{name}": value for name, value in dataclasses.asdict(offline).items()},
        }
        self._digest = stage_digest(self.name, VERSION, self.parameters, self.model_digest, room.digest())

    def prepare(self) -> None:
        """Loads the classifier."""
        self._namer.prepare()

    def digest(self, frame: Frame) -> str:
        """Parameters, model and planes, and from where the frame sees them."""
        pose = frame.world_from_depth
        return digest_of([self._digest, pose.quaternion, pose.translation])

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """What boxes made whole, small boxes before large ones, then the other regions by number."""
        rgb = decode_color(frame) if frame.color else None
        parts = parted(frame, rgb, self._room, self._geometry, self._offline)
        claimed = [] if rgb is None else claims(boxes, parts, rgb, frame.rig.color.fx, self._offline)
        things = [*claimed, *self._left(parts, claimed, working_step(frame.rig.color) ** 2)]
        masks = [Mask.from_bitmap(thing.bitmap) for thing in things]
        extents = [extent_of(mask, parts.z, frame.rig.color) for mask in masks]
        words = [Words()] * len(masks) if rgb is None else self._words(rgb, things, masks, extents)
        colors = [""] * len(masks) if rgb is None else colors_of(rgb, masks)
        sure = self._offline.support_pixels * working_step(frame.rig.color) ** 2
        out = []
        for thing, mask, extent, said, color in zip(things, masks, extents, words, colors, strict=True):
            kind = _kind(thing, mask, extent, parts, sure)
            score = mask_score(mask, kind, bool(said.word[0]), frame.rig.color, self._offline)
            found = captioned(mask, kind, _form(thing, parts), extent, said, color)
            out.append(dataclasses.replace(found, score=score))
        return tuple(out)

    def _left(self, parts: Parts, found: Sequence[Thing], scale: int) -> list[Thing]:
        """Regions that no box took. scale: colour pixels to a working pixel."""
        taken = {region for thing in found for region in thing.regions}
        area = np.bincount(parts.labels.reshape(-1))
        return [
            Thing(parts.labels == label, None, (label,))
            for label in range(1, len(area))
            if area[label] >= (self._geometry if label <= parts.pieces else self._offline).min_pixels * scale
            and label not in taken
        ]

    def _words(
        self, rgb: NDArray[np.uint8], things: Sequence[Thing], masks: Sequence[Mask], extents: Sequence[float]
    ) -> list[Words]:
        """A sure detector's word where its box is the mask's; else the classifier's; else the detector's.

        Of both only words that fit the size. The classifier's other nouns are kept as what the thing may be as well."""
        p = self._offline
        detected = [_word_of_box(thing.box, mask, e) for thing, mask, e in zip(things, masks, extents, strict=True)]
        words = [Words(word) for word in detected]
        unsure = [i for i, (_, score) in enumerate(detected) if score < p.word_sure]
        for i, nouns in zip(unsure, self._namer(rgb, [masks[i] for i in unsure]), strict=True):
            likely = [(noun, probability) for noun, probability in nouns if fits(noun, extents[i])]
            if likely and likely[0][1] >= p.word_classified:
                word = likely[0]
            else:
                word = detected[i] if detected[i][1] >= p.word_likely else ("", SCORE)
            words[i] = Words(word, tuple((noun, UNSURE * score) for noun, score in likely if noun != word[0]))
        return words


def _word_of_box(box: Box | None, mask: Mask, extent: float) -> Word:
    if box is None or box_iou(np.array(box.corners), np.array(mask.box, np.float64)) < AGREE:
        return "", 0.0
    return (EVERYDAY.get(box.label, box.label), box.score) if fits(box.label, extent) else ("", 0.0)


def _kind(thing: Thing, mask: Mask, extent: float, parts: Parts, sure: int) -> MaskKind:
    """A box whose word fits neither the mask nor its size was about something else.

    sure: pixels from which on what stands on something, or was split off, is believed to be a thing of its own."""
    if _word_of_box(thing.box, mask, extent)[0]:
        return "object"
    stands = thing.box is None and (thing.regions[0] > parts.pieces or thing.regions[0] in parts.on)
    return "support" if stands and mask.area >= sure else "region"


def mask_score(mask: Mask, kind: MaskKind, named: bool, camera: Intrinsics, offline: OfflineParameters) -> float:
    """How likely a mask is a whole thing: most where a detector found it, little where it is a small nameless region,
    least where the picture's edge cuts that."""
    if kind != "region" or named:
        return WHOLE if kind == "object" else SCORE
    scale = working_step(camera) ** 2
    x0, y0, x1, y1 = mask.box
    at_edge = x0 == 0 or y0 == 0 or x1 == camera.width or y1 == camera.height
    if at_edge and mask.area < offline.edge_pixels * scale:
        return CUT_OFF
    return SMALL if mask.area < offline.small_pixels * scale else SCORE


def _form(thing: Thing, parts: Parts) -> Form:
    return parts.form.get(thing.regions[0], NO_FORM) if thing.regions else NO_FORM


def guesses(form: Form, kind: MaskKind, extent: float) -> Iterator[str]:
    """What has no word may be what no model knows: a picture (or window), the front of a cabinet, some box."""
    if form.thing == "object" and form.place not in ("", "on the wall") and BOX_SIZE[0] < extent < BOX_SIZE[1]:
        yield "box"
    if form.thing == "vertical surface":
        if form.place != "on the wall" and form.size == "large":
            yield "cabinet"
        if form.place == "on the wall" and kind == "support" and PICTURE_SIZE[0] < extent < PICTURE_SIZE[1]:
            yield "picture"


def captioned(mask: Mask, kind: MaskKind, form: Form, extent: float, said: Words, color: str) -> Mask:
    """The mask with its kind, scores and words. extent: its size in metres."""
    (noun, score), others = said.word, said.others
    if not noun:
        others = (*others, *((guess, GUESS) for guess in guesses(form, kind, extent)))
    return dataclasses.replace(
        mask,
        label=noun or form.thing,
        caption=Form("", noun, "").caption(color) if noun else form.caption(color),
        caption_score=score,
        named=bool(noun),
        kind=kind,
        alternatives=tuple((other, Form("", other, "").caption(color), score) for other, score in others),
    )


def colors_of(rgb: NDArray[np.uint8], masks: Sequence[Mask]) -> list[str]:
    """Words for the colour of each mask, from every second pixel that has only the mask around it."""
    import cv2

    words = color_words(rgb[::2, ::2])
    out = []
    for mask in masks:
        x0, y0 = mask.box[0] & 1, mask.box[1] & 1
        inner = np.asarray(cv2.erode(mask.crop().astype(np.uint8), np.ones((5, 5), np.uint8)), np.uint8)[y0::2, x0::2]
        top, left = (mask.box[1] + y0) // 2, (mask.box[0] + x0) // 2
        here = words[top : top + inner.shape[0], left : left + inner.shape[1]]
        out.append(color_of(np.bincount(here[inner > 0], minlength=len(COLORS))))
    return out
