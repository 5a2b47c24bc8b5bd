"""The steps of a run, rebuilt from its trace without mapping again: what a Rerun observer saw, it can see once more."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.apps.joined import Follower
from openvox.core.errors import InputError
from openvox.core.types import Candidate, Decision, Frame, Intrinsics, Mask, Pose, Rig, Step, VoxelChanges
from openvox.formats.perception import FrameMasks, read_masks
from openvox.formats.recording import read_frames
from openvox.formats.trace import TraceFrame, read_trace
from openvox.formats.trace_schemas import VotesChanged
from openvox.view import votes

NO_CAMERA = Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pictures:
    """Where a trace's frames and masks come from; None: it is shown without."""

    recording: Path | None = None
    perception: Path | None = None


def steps_of(trace: Path, pictures: Pictures) -> Iterator[Step]:
    """Every step of the run. A frame without its recording has no colour, a depth of one pixel and no true pose; a mask
    without its perception has a caption and no pixels. Raises InputError."""
    told_votes, instance_of = Votes(), dict[int, int]()
    with closing(_frames(pictures)) as frames:
        seen, found = Follower(frames), Follower(_masks(pictures))
        for told in read_trace(trace):
            where = f"{trace}, frame {told.frame}"
            instance_of.update(told.regrouped)
            changes = told_votes.apply(where, told.changes)
            if not set(changes.owner.tolist()) <= {0, *instance_of}:
                raise InputError(f"{where}: it does not say whose the fragments are; replay again with this openvox")
            masks = found.at(told.frame)
            if masks is None or len(masks.masks) != len(told.decisions):
                masks = None
            yield Step(
                frame=seen.at(told.frame) or _blind(told),
                masks=masks.masks if masks else tuple(_nameplate(row) for row in told.decisions),
                looked=told.looked,
                decisions=tuple(decision_of(row) for row in told.decisions),
                events=told.events,
                changes=changes,
                instance_of=dict(instance_of),
                voxels=told_votes.voxels,
            )


def decision_of(row: Mapping[str, Any]) -> Decision:
    """A decision as it was before the trace wrote it."""
    fields = {name: row[name] for name in Decision.__dataclass_fields__}
    candidates = tuple(Candidate(**candidate) for candidate in row["candidates"])
    return Decision(**{**fields, "held": tuple(row["held"]), "candidates": candidates})


def _nameplate(row: Mapping[str, Any]) -> Mask:
    """What is left of a mask whose pixels are elsewhere."""
    return Mask((0, 0, 0, 0), np.zeros(0, np.uint8), caption=row["caption"], kind=row["kind"])


class Votes:
    """All votes of a map, as a trace tells them, and what steps say of them."""

    def __init__(self) -> None:
        self.voxels = 0
        self._votes = votes.Votes()

    def apply(self, where: str, told: VotesChanged) -> VoxelChanges:
        """Take over the counts of a frame; returns its changes with the owners and shares that follow from them.

        where: the file and the frame, for InputError if the counts do not go on from what was told before."""
        if told.first_new != self.voxels:
            raise InputError(
                f"{where}: it goes on from {told.first_new} voxels where {self.voxels} were told, a part is missing; "
                "view its map, or replay again"
            )
        self.voxels += len(told.new_index)
        if len(told.voxel) and not (told.voxel.min() >= 0 and told.voxel.max() < self.voxels):
            raise InputError(f"{where}: it tells of voxels that it never named; replay again")
        if len(told.voxel) and not (told.fragment.min() >= votes.NAMELESS and told.count.min() >= 0):
            raise InputError(f"{where}: it tells of negative counts or fragments; replay again")
        self._votes.add(told.voxel.astype(np.int64), told.fragment, told.count)
        touched = np.unique(told.voxel)
        owner, share = self._owners(touched.astype(np.int64))
        return VoxelChanges(
            told.first_new, told.new_index, told.voxel, told.fragment, told.count, touched, owner, share
        )

    def _owners(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Owner of each voxel and its share of all votes there, Q20: as core.types.VoxelChanges has them."""
        group, fragment, count = self._votes.of(rows)
        total = np.bincount(group, count, len(rows)).astype(np.int64)  # exact: far below 2**53
        background = np.bincount(group[fragment == 0], count[fragment == 0], len(rows)).astype(np.int64)
        best, most = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
        named = fragment > 0
        np.maximum.at(most, group[named], count[named])
        strongest = named & (count == most[group]) & (count > 0)
        best[group[strongest][::-1]] = fragment[strongest][::-1]  # the lowest id is written last
        owned = most > background
        share = (np.where(owned, most, background) << 20) // np.maximum(total, 1)
        return np.where(owned, best, 0).astype(np.int32), share.astype(np.int32)


def _frames(pictures: Pictures) -> Generator[Frame, None, None]:
    if pictures.recording is not None:
        yield from read_frames(pictures.recording, truth=False)


def _masks(pictures: Pictures) -> Iterator[FrameMasks]:
    if pictures.perception is not None:
        yield from read_masks(pictures.perception)


def _blind(told: TraceFrame) -> Frame:
    """A frame of which only number and stamp are known."""
    rig = Rig(NO_CAMERA, NO_CAMERA)
    return Frame(told.frame, told.stamp_ns, Pose.identity(), rig, np.zeros((1, 1), np.uint16))
