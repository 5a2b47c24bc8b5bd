"""The map file: a finished InstanceMap as plain arrays in one .npz, with everything else as JSON in `meta`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox import __version__
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap, InstanceSummary
from openvox.formats.atomic import partial_file
from openvox.formats.npz import check_layout, read_arrays, write_arrays

FORMAT_VERSION = 1
SUFFIX = ".map.npz"
STATE = "state_"
COORDINATE_LIMIT = 1 << 20
"""Voxel coordinates are 21-bit integers: at least -COORDINATE_LIMIT and below it."""

LAYOUT: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "voxel_index": ("<i4", ("voxels", 3)),
    "vote_offset": ("<i8", ("voxels + 1",)),
    "vote_fragment": ("<i4", ("votes",)),
    "vote_count": ("<i4", ("votes",)),
    "fragment_id": ("<i4", ("fragments",)),
    "fragment_instance": ("<i4", ("fragments",)),
    "voxel_instance": ("<i4", ("voxels",)),
    "voxel_confidence": ("<f4", ("voxels",)),
    "instance_id": ("<i4", ("instances",)),
    "instance_confidence": ("<f4", ("instances",)),
    "feature": ("<f4", ("instances", "dimensions")),
    "feature_weight": ("<f8", ("instances",)),
}
"""The arrays that are InstanceMap's fields of the same name: dtype and axes."""


def write_map(path: Path, result: InstanceMap) -> None:
    """Write a map, complete or not at all; equal maps give equal bytes. Raises OutputError."""
    arrays = {name: np.ascontiguousarray(getattr(result, name), dtype) for name, (dtype, _) in LAYOUT.items()}
    arrays["meta"] = np.frombuffer(_meta_bytes(result), np.uint8)
    for name in sorted(result.state):
        array = np.asarray(result.state[name])
        arrays[STATE + name] = array.astype(array.dtype.newbyteorder("<"))
    with partial_file(path) as partial:
        write_arrays(partial, arrays)


def read_map(path: Path) -> InstanceMap:
    """Read and check a map file; `meta` is its JSON without what InstanceMap has fields for. Raises InputError."""
    arrays = read_arrays(path, lambda name: name in LAYOUT or name == "meta" or name.startswith(STATE))
    meta = _read_meta(path, arrays)
    lengths = check_layout(path, arrays, LAYOUT)
    if lengths["voxels + 1"] != lengths["voxels"] + 1:
        raise _wrong(path, "vote_offset", f"has {lengths['voxels + 1']} entries for {lengths['voxels']} voxels")
    fields: dict[str, Any] = {name: arrays[name] for name in LAYOUT}
    _check_votes(path, fields)
    _check_instances(path, fields)
    ids = [int(i) for i in fields["instance_id"]]
    return InstanceMap(
        **fields,
        voxel_size=_number(path, meta, "voxel_size"),
        vote_unit=_number(path, meta, "vote_unit"),
        instances=_read_summaries(path, meta.get("instances"), ids),
        meta={key: value for key, value in meta.items() if key not in ("voxel_size", "vote_unit", "instances")},
        state={name.removeprefix(STATE): array for name, array in arrays.items() if name.startswith(STATE)},
    )


def _meta_bytes(result: InstanceMap) -> bytes:
    meta = {
        **result.meta,
        "format_version": FORMAT_VERSION,
        "openvox_version": __version__,
        "voxel_size": result.voxel_size,
        "vote_unit": result.vote_unit,
        "instances": {str(instance.id): summary_as_dict(instance) for instance in result.instances},
    }
    return json.dumps(meta, sort_keys=True, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()


def summary_as_dict(instance: InstanceSummary) -> dict[str, Any]:
    """What the map's meta, and every JSON for people, says about an instance, without its id."""
    return {
        "caption": instance.caption,
        "named": instance.named,
        "captions": [[text, support] for text, support in instance.captions],
        "observations": instance.observations,
        "first_frame": instance.first_frame,
        "last_frame": instance.last_frame,
        "state": instance.state,
        "confirmed_frame": instance.confirmed_frame,
        "bounds": [list(corner) for corner in instance.bounds],
        "voxels": instance.voxels,
    }


def _read_meta(path: Path, arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    if "meta" not in arrays:
        raise InputError(f"{path} is no map file: it has no array meta; a map is what `openvox replay` writes")
    check_layout(path, arrays, {"meta": ("u1", ("bytes",))})
    try:
        meta = json.loads(arrays["meta"].tobytes(), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: meta is no JSON ({error}); make the map anew") from None
    version = meta.get("format_version") if isinstance(meta, dict) else None
    if not isinstance(version, int) or version < 1:
        raise InputError(f"{path}: meta has no format version; expected a map that `openvox replay` wrote")
    if version > FORMAT_VERSION:
        raise InputError(
            f"{path} has map format {version}, this openvox reads up to {FORMAT_VERSION}: use a newer openvox"
        )
    return dict(meta)


def _check_votes(path: Path, a: Mapping[str, NDArray[Any]]) -> None:
    """Rows ascend, each holds votes, votes ascend by fragment."""
    index = a["voxel_index"].astype(np.int64)
    if len(index) and not (index.min() >= -COORDINATE_LIMIT and index.max() < COORDINATE_LIMIT):
        raise _wrong(path, "voxel_index", f"leaves the range of 21 bits ({index.min()} to {index.max()})")
    x, y, z = index.T
    _ascending(path, "voxel_index", ((x << 42) + (y << 21) + z))
    offset = a["vote_offset"]
    inside = offset.min() >= 0 and offset.max() <= len(a["vote_fragment"])  # then differences cannot wrap
    if not inside or offset[0] != 0 or offset[-1] != len(a["vote_fragment"]) or (np.diff(offset) < 1).any():
        raise _wrong(
            path, "vote_offset", f"does not rise from 0 to {len(a['vote_fragment'])} with votes in every voxel"
        )
    fragment = a["vote_fragment"]
    rising = np.diff(fragment.astype(np.int64)) > 0
    rising[offset[1:-1] - 1] = True  # where the next voxel begins
    if not rising.all() or (len(fragment) and fragment.min() < -1):
        raise _wrong(path, "vote_fragment", "does not ascend within its voxels from -1 on")
    if (a["vote_count"] < 1).any():
        raise _wrong(path, "vote_count", "holds a count below 1")
    _ascending(path, "fragment_id", a["fragment_id"])
    _known(path, "vote_fragment", fragment[fragment > 0], "fragment_id", a["fragment_id"])


def _check_instances(path: Path, a: Mapping[str, NDArray[Any]]) -> None:
    """Ids ascend and are known, numbers are finite, features are unit vectors (or zero: never described)."""
    ids = a["instance_id"]
    _ascending(path, "instance_id", ids)
    for name in ("fragment_id", "instance_id"):
        if len(a[name]) and a[name][0] < 1:
            raise _wrong(path, name, f"begins with {a[name][0]}, but ids begin with 1")
    for name in ("fragment_instance", "voxel_instance"):
        _known(path, name, a[name][a[name] != 0], "instance_id", ids)
    for name in ("voxel_confidence", "instance_confidence"):
        if not ((a[name] >= 0) & (a[name] <= 1)).all():
            raise _wrong(path, name, "holds a number outside 0 .. 1")
    if not (np.isfinite(a["feature_weight"]) & (a["feature_weight"] >= 0)).all():
        raise _wrong(path, "feature_weight", "holds a number below 0, or none that is finite")
    length = np.sqrt((a["feature"].astype(np.float64) ** 2).sum(1))
    if not ((np.abs(length - 1.0) < 1e-3) | (length == 0.0)).all():
        raise _wrong(path, "feature", "holds a row that has neither length 1 nor 0")


def _ascending(path: Path, name: str, values: NDArray[Any]) -> None:
    bad = np.flatnonzero(values[1:] <= values[:-1])
    if len(bad):
        raise _wrong(path, name, f"does not ascend at row {bad[0] + 1}")


def _known(path: Path, name: str, values: NDArray[Any], where: str, ids: NDArray[Any]) -> None:
    unknown = values[~np.isin(values, ids)]
    if len(unknown):
        raise _wrong(path, name, f"holds {unknown[0]}, which {where} lacks")


def _read_summaries(path: Path, entries: Any, ids: list[int]) -> tuple[InstanceSummary, ...]:
    if not isinstance(entries, dict) or sorted(entries) != sorted(map(str, ids)):
        raise _wrong(path, "meta", "does not describe the instances of instance_id")
    return tuple(_read_summary(path, i, entries[str(i)]) for i in ids)


def _read_summary(path: Path, number: int, entry: Any) -> InstanceSummary:
    try:
        (x0, y0, z0), (x1, y1, z1) = entry["bounds"]
        low, high = (float(x0), float(y0), float(z0)), (float(x1), float(y1), float(z1))
        confirmed = entry["confirmed_frame"]
        summary = InstanceSummary(
            id=number,
            caption=_text(entry["caption"]),
            captions=tuple((_text(text), float(support)) for text, support in entry["captions"]),
            observations=int(entry["observations"]),
            first_frame=int(entry["first_frame"]),
            last_frame=int(entry["last_frame"]),
            state="confirmed" if entry["state"] == "confirmed" else "tentative",
            confirmed_frame=None if confirmed is None else int(confirmed),
            bounds=(low, high),
            voxels=int(entry["voxels"]),
            named=bool(entry.get("named", True)),
        )
    except (KeyError, TypeError, ValueError, OverflowError, IndexError):
        raise _wrong(path, "meta", f"does not describe instance {number} as a map does") from None
    if not all(math.isfinite(value) for value in (*low, *high, *(support for _, support in summary.captions))):
        raise _wrong(path, "meta", f"has a number of instance {number} that is not finite")
    return summary


def _text(value: Any) -> str:
    """A text that can be printed: half a surrogate pair, which JSON can spell, cannot."""
    if not isinstance(value, str):
        raise TypeError
    value.encode()
    return value


def _number(path: Path, meta: Mapping[str, Any], key: str) -> float:
    value = meta.get(key)
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0.0 < value < 1e6:
        raise _wrong(path, "meta", f"has {key} {value!r}; expected a positive number")
    return float(value)


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def _wrong(path: Path, name: str, what: str) -> InputError:
    return InputError(f"{path}: array {name} {what}; make the map anew with `openvox replay`")
