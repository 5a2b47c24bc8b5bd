"""The lives of instances on Rerun's state timeline, a lane each, named by id and caption."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import rerun as rr

from openvox.core.phrases import short_name
from openvox.core.types import Frame
from openvox.view import entities
from openvox.view.labels import Captions
from openvox.view.lives import FATE

LETTERS = 24
Moment = tuple[int, int]
"""Frame number and stamp, ns: the frame itself would keep its pictures."""


class Lanes:
    """Tells states as they come to who is watching, or all of them in the end, where the last caption names the lane.

    A lane is called as its entity, whose path shows anything but letters and digits escaped."""

    def __init__(self, recording: rr.RecordingStream, captions: Captions, watched: bool) -> None:
        self._recording, self._captions, self._watched = recording, captions, watched
        self._names: dict[int, str] = {}
        self._states: dict[int, list[tuple[Moment, str]]] = {}

    def add(self, frame: Frame, states: Iterable[tuple[int, str]]) -> None:
        """What became of some instances at this frame."""
        for instance, state in states:
            told = self._states.setdefault(instance, [])
            if state == "dropped" and told:
                begin, last = told.pop()
                self._tell(instance, begin, FATE.format(last))
            self._tell(instance, (frame.index, frame.stamp_ns), state)

    def _tell(self, instance: int, when: Moment, state: str) -> None:
        self._states[instance].append((when, state))
        if self._watched:
            path = self._names.setdefault(instance, lane(instance, self._captions.first(instance)))
            rr.send_columns(path, _columns([when]), rr.StateChange.columns(state=[state]), recording=self._recording)

    def finish(self, captions: Mapping[int, str]) -> None:
        """captions: of the finished map's instances; others have the one that most of their own masks had."""
        for instance, states in () if self._watched else sorted(self._states.items()):
            rr.send_columns(
                lane(instance, captions.get(instance) or self._captions.first(instance)),
                _columns([when for when, _ in states]),
                rr.StateChange.columns(state=[state for _, state in states]),
                recording=self._recording,
            )


def _columns(moments: Sequence[Moment]) -> list[rr.TimeColumn]:
    stamps = np.array([stamp for _, stamp in moments], "datetime64[ns]")
    return [
        rr.TimeColumn(entities.FRAME, sequence=[frame for frame, _ in moments]),
        rr.TimeColumn(entities.SENSOR_TIME, timestamp=stamps),
    ]


def lane(instance: int, caption: str) -> str:
    """Entity of an instance's life, as in `lives/0017_white_cup`."""
    words = re.sub(r"[\W_]+", "_", short_name(caption, LETTERS)).strip("_")
    return f"{entities.LIVES}/{instance:04d}{'_' if words else ''}{words}"
