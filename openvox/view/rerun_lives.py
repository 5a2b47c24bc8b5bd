"""The lives of instances on Rerun's state timeline, a lane each, named by id and caption."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np
import rerun as rr

from openvox.core.types import Frame
from openvox.view import entities
from openvox.view.labels import Captions, shortened
from openvox.view.rerun_values import Log

LETTERS = 24


class Lanes:
    """Tells states as they come to who is watching, or all of them in the end, where the last caption names the lane.

    A lane is called as its entity, whose path shows anything but letters and digits escaped."""

    def __init__(self, recording: rr.RecordingStream, log: Log, captions: Captions, watched: bool) -> None:
        self._recording, self._log, self._captions, self._watched = recording, log, captions, watched
        self._names: dict[int, str] = {}
        self._states: dict[int, list[tuple[Frame, str]]] = {}

    def add(self, frame: Frame, states: Iterable[tuple[int, str]]) -> None:
        """What became of some instances at this frame."""
        for instance, state in states:
            if self._watched:
                path = self._names.setdefault(instance, lane(instance, self._captions.first(instance)))
                self._log(path, rr.StateChange(state=state))
            else:
                self._states.setdefault(instance, []).append((frame, state))

    def finish(self, captions: Mapping[int, str]) -> None:
        """captions: of the finished map's instances; others have the one that most of their own masks had. A lane says
        in its name that its instance was dropped: the state itself begins where the lanes end."""
        for instance, states in sorted(self._states.items()):
            caption = captions.get(instance) or self._captions.first(instance)
            frames = [frame for frame, _ in states]
            stamps = np.array([frame.stamp_ns for frame in frames], "datetime64[ns]")
            rr.send_columns(
                lane(instance, f"dropped {caption}".strip() if states[-1][1] == "dropped" else caption),
                indexes=[
                    rr.TimeColumn(entities.FRAME, sequence=[frame.index for frame in frames]),
                    rr.TimeColumn(entities.SENSOR_TIME, timestamp=stamps),
                ],
                columns=rr.StateChange.columns(state=[state for _, state in states]),
                recording=self._recording,
            )


def lane(instance: int, caption: str) -> str:
    """Entity of an instance's life, as in `lives/0017_a_white_cup`."""
    words = re.sub(r"[\W_]+", "_", shortened(caption, LETTERS)).strip("_")
    return f"{entities.LIVES}/{instance:04d}{'_' if words else ''}{words}"
