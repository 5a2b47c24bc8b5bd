"""Where a map comes from: the recording that it names, if it is still the same one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.recording import recording_info
from openvox.formats.times import SUFFIX as TIMES_SUFFIX
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX


def named_digest(result: InstanceMap, name: str) -> str | None:
    """The digest that a map notes of what it was made from, or with: recording, perception, trace."""
    digests = result.meta.get("digests")
    found = digests.get(name) if isinstance(digests, dict) else None
    return found if isinstance(found, str) else None


def recording_of(path: Path, result: InstanceMap, given: Path | None) -> Path | None:
    """The recording with the digest that the map names; None if it is not there.

    path: of the map. given: chosen by the user. Raises InputError where that has another digest."""
    expected = named_digest(result, "recording")
    if given is not None:
        found = recording_info(given).digest
        if found != expected:
            raise InputError(
                f"{given} is not the recording of {path}: its digest is {found[:12]}, the map names "
                f"{(expected or 'none')[:12]}; give the recording that was replayed"
            )
        return given
    named = result.meta.get("recording")
    if not isinstance(named, str) or not named or Path(named).is_absolute():
        return None
    try:
        return path.parent / named if recording_info(path.parent / named).digest == expected else None
    except InputError:
        return None  # it was not asked for


def belonging(path: Path, about: Mapping[str, Any] | None = None) -> Iterator[Path]:
    """A map or trace, what lies beside it of the same run, and the recording and perception that it names.

    about: the map's meta, or the run that the trace notes. The files need not be there."""
    stem = path.name.removesuffix(MAP_SUFFIX).removesuffix(TRACE_SUFFIX)
    yield path
    yield from (path.with_name(stem + suffix) for suffix in (MAP_SUFFIX, TRACE_SUFFIX, TIMES_SUFFIX))
    about = about or {}
    sources = about.get("sources")
    for name in ("recording", "perception"):
        noted = sources.get(name) if isinstance(sources, Mapping) else [about.get(name)]
        if isinstance(noted, (list, tuple)) and noted and isinstance(noted[0], str) and noted[0]:
            yield path.parent / noted[0]
