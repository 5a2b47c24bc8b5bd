"""The front end that needs nothing but depth: what sticks out of the room's planes, cut along steps and creases.

Its regions belong to no class and may be pieces of a thing (kind `region`); captions say size, colour, form and place.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from openvox.core.digest import digest_of
from openvox.core.parameters import Value
from openvox.core.phrases import COLORS
from openvox.core.types import Frame, Mask
from openvox.formats.detections import Box
from openvox.formats.images import decode_color
from openvox.formats.recording import RecordingInfo, read_frames
from openvox.perception.parameters import GeometryParameters
from openvox.perception.planes import Room, find_room
from openvox.perception.regions import at_color_pixels, at_depth_pixels
from openvox.perception.segments import Labels, background_of, segments
from openvox.perception.stage import stage_digest
from openvox.perception.surface import depth_in_metres, surface, working_step
from openvox.perception.wording import color_of, color_words, forms

SCORE = 0.5
"""Of every region and its caption: as likely a piece as a whole thing."""
VERSION = 1


class NoBoxes:
    """Det of a front end that has none: looks at every frame and finds no boxes."""

    name = "none"
    model_digest = ""

    def __init__(self) -> None:
        self.parameters: Mapping[str, Value] = {}
        self._digest = stage_digest(self.name, VERSION, self.parameters)

    def digest(self, frame: Frame) -> str:
        """The same for every frame."""
        return self._digest

    def __call__(self, frame: Frame) -> tuple[Box, ...]:
        """None."""
        return ()


class Geometry:
    """SegCap without a detector: regions of a depth image. Takes the room's planes from the whole recording."""

    name = "geometry"
    model_digest = ""

    def __init__(self, parameters: GeometryParameters, room: Room) -> None:
        self._parameters = parameters
        self._room = room
        self.parameters: Mapping[str, Value] = {
            f"geometry.{name}": value for name, value in dataclasses.asdict(parameters).items()
        }
        self._digest = stage_digest(self.name, VERSION, self.parameters, room.digest())

    def digest(self, frame: Frame) -> str:
        """Parameters and planes, and from where the frame sees them: a new trajectory moves the background."""
        pose = frame.world_from_depth
        return digest_of([self._digest, pose.quaternion, pose.translation])

    def __call__(self, frame: Frame, boxes: tuple[Box, ...]) -> tuple[Mask, ...]:
        """Regions of the frame, pieces first, then left-overs, each by their first pixel row by row."""
        p = self._parameters
        seen = surface(frame.depth, frame.rig.depth, p.near, p.far)
        labels, _ = segments(seen, background_of(seen, self._room, frame.world_from_depth), p)
        form = forms(labels, seen, self._room, frame.world_from_depth)
        labels = at_depth_pixels(labels, seen, depth_in_metres(frame.depth, p.near, p.far))
        labels = smooth(at_color_pixels(labels, frame.depth, frame.rig))
        colors = _colors(labels, frame)
        area = np.bincount(labels.reshape(-1))
        return tuple(
            Mask.from_bitmap(
                labels == label,
                score=SCORE,
                label=form[label].thing,
                caption=form[label].caption(colors[label]),
                caption_score=SCORE,
                named=False,
                kind="region",
            )
            for label in range(1, len(area))
            if area[label] >= p.min_pixels * working_step(frame.rig.color) ** 2
        )


def room_of(recording: RecordingInfo, parameters: GeometryParameters) -> Room:
    """The planes that bound the recording's room, from frames spread evenly over all of it; none if switched off."""
    if not parameters.planes:
        return Room()
    span = recording.last - recording.first + 1
    number = min(parameters.plane_frames, span)
    frames = _frames_from(recording.path, [recording.first + i * span // number for i in range(number)])
    return find_room(
        ((frame, surface(frame.depth, frame.rig.depth, parameters.near, parameters.far)) for frame in frames),
        parameters.plane_area,
    )


def _frames_from(path: Path, numbers: list[int]) -> Iterator[Frame]:
    """The first frame from each number on, none twice."""
    last = -1
    for number in numbers:
        if number > last:
            for frame in read_frames(path, start=number, ahead=0, truth=False):
                last = frame.index
                yield frame
                break


def smooth(labels: Labels) -> Labels:
    """The same regions with frayed outlines cut straight and specks gone."""
    import cv2

    return cv2.medianBlur(labels.astype(np.uint16), 5).astype(np.int32)


def _colors(labels: Labels, frame: Frame) -> list[str]:
    """Words for the colour of each label, from every second pixel that has only its own kind around it."""
    import cv2

    count = int(labels.max()) + 1
    if not frame.color:
        return [""] * count
    words, own = color_words(decode_color(frame)[::2, ::2]), labels[::2, ::2].astype(np.uint16)
    around = np.ones((3, 3), np.uint8)
    inner = cv2.erode(own, around) == cv2.dilate(own, around)
    cells = own[inner].astype(np.int64) * len(COLORS) + words[inner]
    return [color_of(row) for row in np.bincount(cells, minlength=count * len(COLORS)).reshape(count, len(COLORS))]
