"""What a perception file holds of what is asked for, found before anything is computed or written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from openvox.core.digest import frame_digest
from openvox.core.errors import InputError
from openvox.formats.perception import FrameMasks, begin_metadata, perception_info, read_masks
from openvox.formats.recording import RecordingInfo, read_frames, selected
from openvox.perception.pipeline import Pipeline

NOT_COMPARED = ("openvox_version", "dimensions")
"""The length of vectors follows from the encoder's digest; to ask for it would load the encoder."""


@dataclass(frozen=True)
class Selection:
    """Frame numbers that are asked for; see formats.recording.selected."""

    start: int | None = None
    end: int | None = None
    stride: int = 1

    def __post_init__(self) -> None:
        if self.stride < 1:
            raise InputError(f"stride is {self.stride}; expected 1 or more")

    def has(self, index: int) -> bool:
        """True if the frame of that number is asked for."""
        return selected(index, self.start, self.end, self.stride)

    @property
    def everything(self) -> bool:
        """True if no frame is left out."""
        return not self.start and self.end is None and self.stride == 1


@dataclass(frozen=True)
class Held:
    """complete: all that is asked for is there, made as it would be made now. asked: frame numbers to look at.

    beside: frame numbers that are not asked for, made in the same way. others: how many frames that are not asked for
    were made in another way."""

    complete: bool = False
    asked: frozenset[int] = frozenset()
    beside: frozenset[int] = frozenset()
    others: int = 0


def held(target: Path, recording: RecordingInfo, pipeline: Pipeline, selection: Selection) -> Held:
    """Of the file at `target`; nothing if there is none, or it is damaged. Raises InputError about the recording."""
    if not target.exists():
        return Held()
    try:
        known = {found.index: found for found in map(_without_masks, read_masks(target))}
        begin = begin_metadata(target, recording, pipeline.described(), pipeline.enc.name, 0)
        metadata = perception_info(target).metadata
    except InputError:
        return Held()
    complete = all(metadata.get(key) == value for key, value in begin.items() if key not in NOT_COMPARED)
    if selection.everything and not complete:
        return Held()
    same, asked = set[int](), set[int]()
    for frame in read_frames(recording.path):
        wanted = selection.has(frame.index) and pipeline.looks_at(frame)
        if wanted:
            asked.add(frame.index)
        if frame.index in known and _made_so(known[frame.index], frame_digest(frame), pipeline.keys(frame)):
            same.add(frame.index)
        elif wanted and selection.everything:
            return Held()
    beside = {index for index in known if not selection.has(index)}
    return Held(
        complete=complete and asked == known.keys() - beside <= same and beside <= same,
        asked=frozenset(asked),
        beside=frozenset(beside & same),
        others=len(beside - same),
    )


def _without_masks(found: FrameMasks) -> FrameMasks:
    """Only the digests: those of a long recording fit into memory."""
    return FrameMasks(found.index, found.stamp_ns, found.frame_digest, (), found.size, (), found.stage_digests)


def _made_so(found: FrameMasks, digest: str, keys: tuple[str, str, str]) -> bool:
    """Boxes are not read: the second key holds the first."""
    return found.frame_digest == digest and found.stage_digests[1:] == keys[1:]
