"""Small hand-made maps for tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.core.types import InstanceMap, InstanceSummary

META = {"preset": "openvox", "engine": "cpu", "encoder": "test", "digests": {"recording": "ab", "map": "cd"}}


def summary(number: int, caption: str, voxels: int = 1, **changes: Any) -> InstanceSummary:
    fields: dict[str, Any] = {
        "captions": ((caption, 2.0),),
        "observations": 3,
        "first_frame": 0,
        "last_frame": 9,
        "state": "confirmed",
        "confirmed_frame": 4,
        "bounds": ((0.0, 0.0, 0.0), (0.04, 0.04, 0.04)),
    }
    return InstanceSummary(id=number, caption=caption, voxels=voxels, **{**fields, **changes})


def small_map() -> InstanceMap:
    """Four voxels, three fragments, two instances: 2 (a lamp) and 5 (a chair, of fragments 5 and 7)."""
    return InstanceMap(
        voxel_index=np.array([[-1, 0, 0], [0, 0, 1], [0, 1, 0], [3, 0, 0]], np.int32),
        vote_offset=np.array([0, 2, 3, 5, 6], np.int64),
        vote_fragment=np.array([0, 2, 2, 5, 7, 0], np.int32),
        vote_count=np.array([1, 2, 3, 4, 5, 6], np.int32),
        fragment_id=np.array([2, 5, 7], np.int32),
        fragment_instance=np.array([2, 5, 5], np.int32),
        voxel_instance=np.array([2, 2, 5, 0], np.int32),
        voxel_confidence=np.array([2 / 3, 1, 1, 1], np.float32),
        instance_id=np.array([2, 5], np.int32),
        instance_confidence=np.array([0.5, 0.25], np.float32),
        feature=np.array([[1, 0, 0], [0, 0.6, 0.8]], np.float32),
        feature_weight=np.array([1.5, 2.0]),
        voxel_size=0.04,
        vote_unit=0.5,
        instances=(summary(2, "a lamp", 2), summary(5, "ein grüner Stuhl", 1)),
        meta=META,
        state={"next_id": np.array([8]), "pairs": np.array([[2, 5, 1]], np.int32)},
    )


def labelled_map(
    index: NDArray[np.int32],
    label: NDArray[np.int32],
    *,
    voxel_size: float = 0.04,
    confidence: Mapping[int, float] | None = None,
    voxel_confidence: float = 1.0,
    captions: Mapping[int, str] | None = None,
    features: Mapping[int, NDArray[np.float32]] | None = None,
    meta: Mapping[str, Any] | None = None,
) -> InstanceMap:
    """A map whose voxels carry these labels (0 = background), one vote each; rows in any order, each cell once."""
    order = np.lexsort(index.T[::-1])
    index, label = index[order].astype(np.int32), label[order].astype(np.int32)
    ids = np.unique(label[label > 0])
    feature = [(features or {}).get(int(i), [1.0, 0.0]) for i in ids]
    return InstanceMap(
        voxel_index=index,
        vote_offset=np.arange(len(index) + 1, dtype=np.int64),
        vote_fragment=label,
        vote_count=np.ones(len(index), np.int32),
        fragment_id=ids,
        fragment_instance=ids,
        voxel_instance=label,
        voxel_confidence=np.full(len(index), voxel_confidence, np.float32),
        instance_id=ids,
        instance_confidence=np.array([(confidence or {}).get(int(i), 0.5) for i in ids], np.float32),
        feature=np.array(feature, np.float32) if len(ids) else np.zeros((0, 2), np.float32),
        feature_weight=np.ones(len(ids)),
        voxel_size=voxel_size,
        vote_unit=1.0,
        instances=tuple(
            summary(
                int(i),
                (captions or {}).get(int(i), f"thing {i}"),
                int((label == i).sum()),
                bounds=_bounds(index[label == i], voxel_size),
            )
            for i in ids
        ),
        meta=META if meta is None else meta,
    )


def _bounds(index: NDArray[np.int32], voxel_size: float) -> Any:
    return tuple((index.min(0) * voxel_size).tolist()), tuple(((index.max(0) + 1) * voxel_size).tolist())
