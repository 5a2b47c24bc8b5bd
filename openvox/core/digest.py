"""SHA-256 over defined bytes: frames, recordings, canonical JSON. Nothing here depends on time or machine."""

from __future__ import annotations

import hashlib
import json
import struct
from typing import Any

import numpy as np

from openvox.core.types import Frame, InstanceMap, Intrinsics

START = "0" * 64
"""The link before the first of a chain."""


def canonical_json(value: Any) -> bytes:
    """Sorted keys, no spaces, ASCII: equal values give equal bytes."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()


def digest_of(value: Any) -> str:
    """SHA-256 of canonical JSON, lowercase hex."""
    return hashlib.sha256(canonical_json(value)).hexdigest()


def chain(previous: str, *parts: bytes) -> str:
    """The next link: SHA-256 over the previous link and the parts, each with its length."""
    h = hashlib.sha256(bytes.fromhex(previous))
    for part in parts:
        h.update(struct.pack("<Q", len(part)))
        h.update(part)
    return h.hexdigest()


def _intrinsics_bytes(camera: Intrinsics) -> bytes:
    return struct.pack("<II4d", camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


def frame_digest(frame: Frame) -> str:
    """Over colour bytes, depth values and both calibrations, without pose or stamp: what perception depends on."""
    parts = (
        frame.color,
        np.ascontiguousarray(frame.depth, "<u2").tobytes(),
        _intrinsics_bytes(frame.rig.color),
        _intrinsics_bytes(frame.rig.depth),
        struct.pack("<7d", *frame.rig.depth_from_color.quaternion, *frame.rig.depth_from_color.translation),
    )
    return chain(START, *parts)


def recording_link(previous: str, digest: str, frame: Frame) -> str:
    """d_i = SHA-256(d_(i-1) | frame digest | pose | stamp): the recording's digest is the last link.

    Bytes: two digests of 32, quaternion x y z w and translation as 7 little-endian float64, stamp as int64."""
    pose = struct.pack("<7d", *frame.world_from_depth.quaternion, *frame.world_from_depth.translation)
    stamp = struct.pack("<q", frame.stamp_ns)
    return hashlib.sha256(bytes.fromhex(previous) + bytes.fromhex(digest) + pose + stamp).hexdigest()


def map_digest(result: InstanceMap) -> str:
    """SHA-256 over the contract's arrays as little-endian bytes in the contract's order, lowercase hex."""
    h = hashlib.sha256()
    for array, dtype in (
        (result.voxel_index, "<i4"),
        (result.vote_offset, "<i8"),
        (result.vote_fragment, "<i4"),
        (result.vote_count, "<i4"),
        (result.fragment_id, "<i4"),
        (result.fragment_instance, "<i4"),
        (result.voxel_instance, "<i4"),
        (result.instance_id, "<i4"),
        (result.feature, "<f4"),
    ):
        h.update(np.ascontiguousarray(array, dtype).tobytes())
    return h.hexdigest()
