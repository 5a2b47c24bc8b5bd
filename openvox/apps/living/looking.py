"""Who looks at the frames of a live run: an earlier perception of the recording that is played, or a front end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from openvox.core.digest import frame_digest
from openvox.core.errors import InputError
from openvox.core.types import Frame
from openvox.formats.perception import FrameMasks, perception_info, read_masks

LiveFrontend = Literal["offline", "geometry"]


@dataclass(frozen=True, eq=False)
class Eyes:
    """`look` finds a frame's masks with embeddings, None where it does not look; what a perception file says of it."""

    look: Callable[[Frame], FrameMasks | None]
    stages: Sequence[Mapping[str, Any]]
    encoder: str
    dimensions: int


def cached(path: Path) -> Eyes:
    """What an earlier run found, for frames that come by rising number. Raises InputError, also while looking."""
    from openvox.perception.pipeline import Shelf

    info = perception_info(path)
    shelf = Shelf(read_masks(path, boxes=True))

    def look(frame: Frame) -> FrameMasks | None:
        found = shelf.at(frame.index)
        if found is not None and found.frame_digest != frame_digest(frame):
            raise InputError(
                f"{path}, frame {frame.index}: its masks were made from other pixels than those that come; name "
                "another with --perception, or a --frontend"
            )
        return found

    return Eyes(look, info.stages, info.encoder, info.dimensions)


def front_end(name: LiveFrontend) -> Eyes:
    """A front end that knows nothing of the room beforehand, so that floor and walls come out as regions, too."""
    from openvox.perception.captions import CaptionEncoder
    from openvox.perception.encoder import encoder
    from openvox.perception.geometry import Geometry, NoBoxes
    from openvox.perception.parameters import PerceptionParameters
    from openvox.perception.pipeline import ROLES, Pipeline, perceive_frame
    from openvox.perception.planes import Room

    parameters, captions = PerceptionParameters(), CaptionEncoder(encoder("minilm"))
    if name == "geometry":
        pipeline = Pipeline(NoBoxes(), Geometry(parameters.geometry, Room()), captions)
    else:
        from openvox.perception.nanodet import NanoDet
        from openvox.perception.offline import Offline

        stages = Offline(parameters.geometry, parameters.offline, Room())
        pipeline = Pipeline(NanoDet(parameters.offline), stages, captions)
    for role in ROLES:
        pipeline.ready(role)

    def look(frame: Frame) -> FrameMasks | None:
        return perceive_frame(pipeline, frame)[0]

    return Eyes(look, pipeline.described(), pipeline.enc.name, pipeline.enc.dimensions)
