"""A mapper as arrays and back: what a map file keeps so that a run can go on where it stopped, bit by bit.

Voxels and votes are in the map already; here is the rest. Names are those of `InstanceMap.state`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.mapper.codebook import Fragment
from openvox.mapper.evidence import Evidence
from openvox.mapper.frameset import BITS, FrameSet
from openvox.mapper.life import Life

Arrays = Mapping[str, NDArray[Any]]
VERSION = 5


def fragment_arrays(fragments: Mapping[int, Fragment], dimensions: int) -> dict[str, NDArray[Any]]:
    """Fragments by id from 1: numbers, codebook sums, sets of frames, captions as JSON."""
    parts = [fragments[f] for f in sorted(fragments)]
    numbers = [
        (part.first_frame, part.last_frame, part.weight, part.score, part.observations, part.voxels) for part in parts
    ]
    captions = json.dumps(
        [[[*said, n] for said, n in sorted(part.captions.items())] for part in parts], ensure_ascii=True
    )
    return {
        "fragment": np.array(numbers, np.int64).reshape(len(parts), 6),
        "total": np.array([part.total for part in parts], np.int64).reshape(len(parts), dimensions),
        **_frame_arrays("matched", [part.matched for part in parts]),
        **_frame_arrays("seen", [part.seen for part in parts]),
        "captions": np.frombuffer(captions.encode(), np.uint8),
    }


def restored_fragments(state: Arrays) -> dict[int, Fragment]:
    """The fragments of `fragment_arrays`. Raises KeyError or ValueError on foreign arrays."""
    captions = json.loads(state["captions"].tobytes())
    matched, seen = (_restored_frames(name, state, len(captions)) for name in ("matched", "seen"))
    fragments = {}
    for i, (first, last, weight, score, observations, voxels) in enumerate(state["fragment"].tolist()):
        part = Fragment(i + 1, first, last, state["total"][i].astype(np.int64))
        part.weight, part.score, part.observations, part.voxels = weight, score, observations, voxels
        part.matched, part.seen = matched[i], seen[i]
        part.captions = {(str(label), str(text)): int(support) for label, text, support in captions[i]}
        part.refresh()
        fragments[part.id] = part
    return fragments


def evidence_arrays(evidence: Evidence) -> dict[str, NDArray[Any]]:
    """Pair counts as rows (smaller id, larger id, count), ascending."""
    return {
        name: np.array([(f, g, n) for (f, g), n in sorted(counts.items())], np.int64).reshape(len(counts), 3)
        for name, counts in (("together", evidence.together), ("apart", evidence.apart))
    }


def restore_evidence(evidence: Evidence, state: Arrays, fragments: Mapping[int, Fragment]) -> None:
    """Fill an empty Evidence with the pair counts and cluster all fragments."""
    for f in fragments:
        evidence.add_fragment(f)
    together, apart = ({(f, g): n for f, g, n in state[name].tolist()} for name in ("together", "apart"))
    evidence.restore(together, apart)
    evidence.update(fragments, fragments)
    evidence.regrouped()  # nothing of it is news


def life_arrays(life: Life, looked: int, dimensions: int | None) -> dict[str, NDArray[Any]]:
    """Confirmations as rows (instance, frame), and counters: version, frames looked at, last frame, dimensions."""
    counters = (VERSION, looked, life.frame, -1 if dimensions is None else dimensions)
    return {
        "confirmed": np.array(sorted(life.confirmed.items()), np.int64).reshape(len(life.confirmed), 2),
        "counters": np.array(counters, np.int64),
    }


def restore_life(life: Life, state: Arrays) -> tuple[int, int | None]:
    """Fill Life; returns the frames looked at and the dimensions of embeddings. Raises InputError."""
    version, looked, frame, dimensions = state["counters"].tolist()
    if version != VERSION:
        raise InputError(f"the map's state has version {version}; this openvox resumes version {VERSION}: replay anew")
    life.confirmed.update((instance, at) for instance, at in state["confirmed"].tolist())
    life.frame = frame
    return looked, None if dimensions < 0 else dimensions


def _frame_arrays(name: str, sets: Sequence[FrameSet]) -> dict[str, NDArray[Any]]:
    """Sets of frames as blocks: rows (number of the set, block), ascending, and the bits of each."""
    blocks = [(i, block, bits) for i, one in enumerate(sets) for block, bits in sorted(one.blocks.items())]
    packed = b"".join(bits.to_bytes(BITS // 8, "little") for _, _, bits in blocks)
    return {
        f"{name}_block": np.array([row[:2] for row in blocks], np.int64).reshape(len(blocks), 2),
        f"{name}_bits": np.frombuffer(packed, np.uint8).reshape(len(blocks), BITS // 8),
    }


def _restored_frames(name: str, state: Arrays, sets: int) -> list[FrameSet]:
    out = [FrameSet() for _ in range(sets)]
    for (i, block), bits in zip(state[f"{name}_block"].tolist(), state[f"{name}_bits"], strict=True):
        out[i].blocks[block] = int.from_bytes(bits.tobytes(), "little")
    return out
