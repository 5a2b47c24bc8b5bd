"""info: what a file holds and what it was made from. The kind is found from the content, not from the name."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.core.types import Intrinsics

RRD = b"RRF2"
"""First bytes of a file of Rerun."""
_ZIP = (b"PK\x03\x04", b"PK\x05\x06")


def info(path: Path) -> dict[str, Any]:
    """`kind` (recording, perception, map, trace, rrd), `digest`, `frames` and what the kind has. Raises InputError."""
    if is_rrd(path):
        from openvox.view.rrd_contents import rrd_info

        return {"kind": "rrd", "path": str(path), **rrd_info(path)}
    kind = kind_of(path)
    found = {"recording": _recording, "perception": _perception, "map": _map, "trace": _trace}[kind](path)
    return {"kind": kind, "path": str(path), **found}


def is_rrd(path: Path) -> bool:
    """Whether a file begins as those of Rerun do. Raises InputError where it cannot be read."""
    return _first_bytes(path, len(RRD)) == RRD


def _first_bytes(path: Path, length: int) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(length)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error})") from None


def kind_of(path: Path) -> str:
    """recording, perception, map or trace, from the file's first bytes and its topics. Raises InputError."""
    from openvox.formats.growing import growing_topics, is_unfinished
    from openvox.formats.mcap_io import MAGIC, read_topics

    start = _first_bytes(path, len(MAGIC))
    if start.startswith(_ZIP):
        return "map"
    if start != MAGIC:
        raise InputError(f"{path} {_foreign(start)}; expected a recording, perception or trace (MCAP), or a map (npz)")
    topics = growing_topics(path) if is_unfinished(path) else read_topics(path)
    rooms = {topic.split("/")[1] if topic.startswith("/") else topic for topic in topics}
    # a recording may hold topics of others, too, so that it is asked for last
    for room, kind in (("mapper", "trace"), ("perception", "perception"), ("camera", "recording")):
        if room in rooms:
            return kind
    if not rooms and is_unfinished(path):
        raise InputError(
            f"{path} holds no whole message yet; if its writer is gone, openvox recover saves what there is"
        )
    raise InputError(f"{path} has topics under {', '.join(sorted(rooms)) or 'nothing'}; openvox writes no such file")


def _foreign(start: bytes) -> str:
    """What a file is whose first bytes are of no file of ours."""
    if not start:
        return "is empty"
    if start.lower().startswith((b"<!doct", b"<html")):
        return "is a web page"
    text = all(32 <= byte < 127 or byte in b"\t\r\n" for byte in start)
    return "is a text file" if text else f"begins with {start.hex()}"


def check_kind(path: Path, wanted: str) -> None:
    """Raises InputError where a file is whole, but of another kind; what is broken is left to its reader.

    wanted: map or trace."""
    try:
        found = kind_of(path)
    except InputError:
        return
    if found == wanted:
        return
    endings = {"map": ".map.npz", "trace": ".trace.mcap"}
    stem = next((path.name.removesuffix(end) for end in endings.values() if path.name.endswith(end)), None)
    beside = path.with_name(f"{stem}{endings[wanted]}") if stem else None
    hint = f"; its {wanted} is {beside}" if beside is not None and beside.is_file() else f"; expected a {wanted}"
    raise InputError(f"{path} is a {found}{hint}")


def parameters() -> dict[str, Any]:
    """Every parameter of the mapper, of perception and of exports: {"parameters": [one object each]}."""
    from openvox.core.export_parameters import ExportParameters
    from openvox.core.mapper_parameters import MapperParameters
    from openvox.core.parameters import describe
    from openvox.perception.parameters import PerceptionParameters

    rows = []
    groups = (("replay", MapperParameters()), ("perceive", PerceptionParameters()), ("export", ExportParameters()))
    for command, group in groups:
        rows += [{**asdict(row), "range": row.range, "command": command} for row in describe(group)]
    return {"parameters": rows}


def _recording(path: Path) -> dict[str, Any]:
    from openvox.formats.recording import recording_info

    found = recording_info(path)
    return {
        "digest": found.digest,
        "frames": found.frames,
        "first": found.first,
        "last": found.last,
        "seconds": found.seconds,
        "path_length_m": found.path_length_m,
        "source": found.source,
        "depth_unit": found.depth_unit,
        "dropped": dict(found.dropped),
        "origin_m": list(found.origin_m),
        "has_color": found.has_color,
        "has_truth": found.has_truth,
        "categories": len(found.categories),
        "color_camera": _camera(found.rig.color) if found.has_color else None,
        "depth_camera": _camera(found.rig.depth),
        "registered": found.rig.registered,
        "openvox_version": found.metadata.get("openvox_version"),
        "format_version": found.metadata.get("format_version"),
    }


def _camera(camera: Intrinsics) -> dict[str, float]:
    return asdict(camera)


def _perception(path: Path) -> dict[str, Any]:
    from openvox.apps.masks_summary import masks_summary
    from openvox.formats.perception import perception_info

    found = perception_info(path)
    return {
        "digest": found.digest,
        "frames": found.frames,
        "masks": found.masks,
        "kinds": dict(found.kinds),
        "encoder": found.encoder,
        "dimensions": found.dimensions,
        "recording": found.recording,
        "recording_digest": found.recording_digest,
        "stages": [dict(stage) for stage in found.stages],
        **masks_summary(path),
        "openvox_version": found.metadata.get("openvox_version"),
        "format_version": found.metadata.get("format_version"),
    }


def _map(path: Path) -> dict[str, Any]:
    from openvox.core.digest import map_digest
    from openvox.formats.map_npz import read_map

    found = read_map(path)
    size = found.voxel_size
    bounds = None
    if len(found.voxel_index):
        low, high = found.voxel_index.min(0), found.voxel_index.max(0) + 1
        bounds = [[float(x * size) for x in corner] for corner in (low, high)]
    return {
        **{key: value for key, value in sorted(found.meta.items()) if key not in ("kind", "path")},
        "digest": map_digest(found),
        "frames": found.meta.get("frames"),
        "voxels": len(found.voxel_index),
        "votes": len(found.vote_count),
        "fragments": len(found.fragment_id),
        "instances": len(found.instance_id),
        "voxel_size": size,
        "vote_unit": found.vote_unit,
        "bounds": bounds,
        "dimensions": found.feature.shape[1],
    }


def _trace(path: Path) -> dict[str, Any]:
    from openvox.formats.trace import trace_info

    return {name: value for name, value in asdict(trace_info(path)).items() if name != "path"}
