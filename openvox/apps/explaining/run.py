"""A whole run as its trace has it: decisions, events, and every change of a vote, in columns."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.mapper_parameters import preset
from openvox.core.parameters import as_dict
from openvox.formats.trace import TraceFrame, read_trace, trace_info

Longs = NDArray[np.int64]
Row = Mapping[str, Any]
SHORTEST_WORD = 3
"""Letters: articles and prepositions say nothing about what a thing is."""


@dataclass(frozen=True, eq=False)
class Run:
    """The frames of a trace, and its votes. A place (voxel) has a number, in the order of first votes.

    The columns have one row a changed count, in the order of the trace: voxel number, fragment (0 = background), count
    after the frame, count before it, and the position of the frame in `frames`."""

    path: Path
    parameters: Mapping[str, Any]
    frames: tuple[TraceFrame, ...]
    index: NDArray[np.int32]
    """(N, 3): floor(world / voxel_size) of every voxel."""
    voxel: Longs
    fragment: Longs
    count: Longs
    before: Longs
    position: Longs
    first: Longs
    """(frames + 1,): rows of frame i are first[i]:first[i + 1]."""

    @property
    def voxel_size(self) -> float:
        """Edge of a voxel, metres."""
        return float(self.parameters["map.voxel_size"])

    @property
    def vote_unit(self) -> float:
        """Votes that one count stands for: a half where background votes, else one."""
        return 0.5 if self.parameters["evolution.background"] else 1.0

    def position_of(self, frame: int) -> int:
        """Where the frame of that number stands. Raises InputError."""
        for position, found in enumerate(self.frames):
            if found.frame == frame:
                return position
        raise InputError(f"{self.path}: frame {frame} was not mapped; it holds {len(self.frames)} frames")

    def instances_before(self, position: int) -> dict[int, int]:
        """Instance of every fragment before a frame."""
        out: dict[int, int] = {}
        for found in self.frames[:position]:
            out.update(found.regrouped)
        return out

    @cached_property
    def final(self) -> dict[int, int]:
        """Instance of every fragment after the last frame."""
        return self.instances_before(len(self.frames))

    @cached_property
    def dropped(self) -> dict[int, str]:
        """Instances that finishing left out, and why."""
        events = self.frames[-1].events if self.frames else ()
        return {event.instance: event.text for event in events if event.kind == "dropped"}

    def decisions(self) -> Iterator[tuple[int, Row]]:
        """All decisions that led to an instance, with the position of their frame."""
        for position, found in enumerate(self.frames):
            for row in found.decisions:
                if row["fragment"]:
                    yield position, row

    def cast(self, position: int, held: list[int]) -> Longs:
        """Voxels that gained votes for these fragments in a frame, ascending."""
        rows = slice(int(self.first[position]), int(self.first[position + 1]))
        gained = (self.count[rows] > self.before[rows]) & np.isin(self.fragment[rows], held)
        return np.unique(self.voxel[rows][gained])

    def votes_at(self, position: int) -> tuple[Longs, Longs, Longs]:
        """Voxel, fragment and count of every vote before a frame, by voxel, then fragment."""
        end = int(self.first[position])
        key = _key(self.voxel[:end], self.fragment[:end])
        order = np.argsort(key, kind="stable")
        last = order[np.append(key[order][1:] != key[order][:-1], True)] if end else order
        last = last[self.count[last] > 0]
        return self.voxel[last], self.fragment[last], self.count[last]

    @cached_property
    def final_votes(self) -> tuple[Longs, Longs, Longs]:
        """Voxel, fragment and count of every vote after the last frame."""
        return self.votes_at(len(self.frames))

    def shares(self, position: int, instance_of: Mapping[int, int]) -> tuple[Longs, Longs, Longs, Longs]:
        """Votes by instance before a frame: voxel, instance (0 = background), count, and all votes by voxel number."""
        voxel, fragment, count = self.votes_at(position)
        lookup = np.zeros(max([0, *instance_of]) + 1, np.int64)
        for f, instance in instance_of.items():
            lookup[f] = instance
        total = np.zeros(len(self.index), np.int64)
        np.add.at(total, voxel, count)
        named = fragment >= 0  # votes without a name count in totals only
        packed, where = np.unique((voxel[named] << 32) | lookup[fragment[named]], return_inverse=True)
        summed = np.zeros(len(packed), np.int64)
        np.add.at(summed, where, count[named])
        return packed >> 32, packed & 0xFFFFFFFF, summed, total

    @cached_property
    def final_owner(self) -> Longs:
        """(N,): instance with most votes in each voxel after the last frame, the lowest id on a tie; 0 = background.

        By votes alone: the finished map also smooths, and drops what it does not believe in."""
        voxel, instance, count, _ = self.shares(len(self.frames), self.final)
        return strongest(voxel, instance, count, len(self.index))

    def center(self, voxel: int) -> list[float]:
        """Middle of a voxel, metres."""
        return [round((int(i) + 0.5) * self.voxel_size, 6) for i in self.index[voxel]]


def strongest(voxel: Longs, instance: Longs, count: Longs, voxels: int) -> Longs:
    """The instance with most votes in each voxel if it beats background, the lowest id on a tie; else 0."""
    rank = np.zeros(voxels, np.int64)
    np.maximum.at(rank, voxel, (count << 32) | (0xFFFFFFFF - instance))
    return np.where(rank > 0, 0xFFFFFFFF - (rank & 0xFFFFFFFF), 0)


def read_run(path: Path) -> Run:
    """The whole run of a trace. Raises InputError."""
    info = trace_info(path)
    frames = tuple(read_trace(path))
    joined = any(decision["fragment"] for found in frames for decision in found.decisions)
    if joined and not any(found.regrouped for found in frames):
        raise InputError(f"{path}: it does not say which fragments are one instance, as older traces do; replay again")
    lengths = [len(found.changes.voxel) for found in frames]
    voxel, fragment, count = (
        _joined([getattr(found.changes, name) for found in frames]) for name in ("voxel", "fragment", "count")
    )
    return Run(
        path=path,
        parameters={**as_dict(preset("openvox")), **info.run.get("parameters", {})},
        frames=frames,
        index=np.concatenate([np.zeros((0, 3), np.int32), *(found.changes.new_index for found in frames)]),
        voxel=voxel,
        fragment=fragment,
        count=count,
        before=_before(voxel, fragment, count),
        position=np.repeat(np.arange(len(frames)), lengths),
        first=np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]),
    )


def _joined(parts: list[NDArray[np.int32]]) -> Longs:
    return np.concatenate([np.zeros(0, np.int64), *parts]).astype(np.int64)


def _key(voxel: Longs, fragment: Longs) -> Longs:
    """Ascends by voxel, then fragment; -1 is a fragment, too."""
    return (voxel << 32) | (fragment + 1)


def _before(voxel: Longs, fragment: Longs, count: Longs) -> Longs:
    """The count that each row replaced, 0 where it is the first of its voxel and fragment."""
    key = _key(voxel, fragment)
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    out = np.zeros(len(key), np.int64)
    out[order[1:]] = np.where(same, count[order][:-1], 0)
    return out


def words_of(caption: str) -> frozenset[str]:
    """The words of a caption, without short ones."""
    return frozenset(word for word in re.findall(r"\w+", caption.casefold()) if len(word) >= SHORTEST_WORD)
