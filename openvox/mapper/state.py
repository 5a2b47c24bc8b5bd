"""A mapper as arrays and back: what a map file keeps so that a run can go on where it stopped, bit by bit.

Voxels and votes are in the map already; here is the rest. Names are those of `InstanceMap.state`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.mapper.codebook import Fragment
from openvox.mapper.evidence import Evidence
from openvox.mapper.life import Life

Arrays = Mapping[str, NDArray[Any]]
VERSION = 1


def fragment_arrays(fragments: Mapping[int, Fragment], looked: int, dimensions: int) -> dict[str, NDArray[Any]]:
    """Fragments by id from 1: numbers, codebook sums, frames as bits, captions as JSON."""
    parts = [fragments[f] for f in sorted(fragments)]
    size = (looked + 7) // 8
    numbers = [
        (part.first_frame, part.last_frame, part.weight, part.score, part.observations, part.voxels) for part in parts
    ]
    captions = json.dumps([sorted(part.captions.items()) for part in parts], ensure_ascii=True)
    return {
        "fragment": np.array(numbers, np.int64).reshape(len(parts), 6),
        "total": np.array([part.total for part in parts], np.int64).reshape(len(parts), dimensions),
        "matched": _bits([part.matched for part in parts], size),
        "seen": _bits([part.seen for part in parts], size),
        "captions": np.frombuffer(captions.encode(), np.uint8),
    }


def restored_fragments(state: Arrays) -> dict[int, Fragment]:
    """The fragments of `fragment_arrays`. Raises KeyError or ValueError on foreign arrays."""
    captions = json.loads(state["captions"].tobytes())
    matched, seen = state["matched"], state["seen"]
    fragments = {}
    for i, (first, last, weight, score, observations, voxels) in enumerate(state["fragment"].tolist()):
        part = Fragment(i + 1, first, last, state["total"][i].astype(np.int64))
        part.weight, part.score, part.observations, part.voxels = weight, score, observations, voxels
        part.matched = int.from_bytes(matched[i].tobytes(), "little")
        part.seen = int.from_bytes(seen[i].tobytes(), "little")
        part.captions = {str(text): int(support) for text, support in captions[i]}
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
    for f, g, amount in state["together"].tolist():
        evidence.add_together(f, g, amount)
    for f, g, amount in state["apart"].tolist():
        evidence.add_apart(f, g, amount)
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


def _bits(values: list[int], size: int) -> NDArray[np.uint8]:
    rows = b"".join(value.to_bytes(size, "little") for value in values)
    return np.frombuffer(rows, np.uint8).reshape(len(values), size)
