"""report: a page to keep and to send around, of a map, of two maps, or of a sweep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from openvox.apps.info import kind_of
from openvox.apps.origin import belonging, named_digest, recording_of
from openvox.core.digest import map_digest
from openvox.core.errors import InputError, OutputError
from openvox.core.types import InstanceMap
from openvox.formats.atomic import check_not_input, check_writable, partial_file
from openvox.formats.map_npz import SUFFIX, read_map
from openvox.formats.recording import recording_info
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.trace import trace_info
from openvox.view.page.document import Html

SUFFIXES = (".html", ".htm")
SUSPECTS = 20
"""Decisions that the page lists for a first look."""


@dataclass(frozen=True)
class Report:
    """What was written, and what it shows."""

    out: Path
    replaced: bool
    """An older file of that name."""
    kind: str
    """map, maps or sweep."""
    bytes: int
    instances: int | None
    """Of the map; None for two maps or a sweep."""
    trace: Path | None
    recording: Path | None
    notes: tuple[str, ...]
    """What the page leaves out, and why."""


def report(
    first: Path, second: Path | None, out: Path, *, recording: Path | None = None, classes: Path | None = None
) -> Report:
    """Write one HTML file with all that it shows in it.

    first: a map, or the folder of a sweep. second: the map's trace (without it, STEM.trace.mcap beside the map, if it
    is the map's), or another map to compare it with. recording: where crops come from; without it, the one that the
    map names, if it is the same.
    classes: names for its categories, which otherwise come from captions. The
    same files give the same bytes. Raises InputError, OutputError.
    """
    if out.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{out} would be overwritten with a web page; let the last argument end with .html")
    if classes is not None and (first.is_dir() or (second is not None and kind_of(second) == "map")):
        raise InputError(f"--classes {classes} has no effect here, because only the page of one map has categories")
    check_writable(out)
    if first.is_dir():
        return _written(out, "sweep", _sweep(first, second, recording))
    kind = kind_of(first)
    if kind != "map":
        raise InputError(f"{first} is a {kind}; a report begins with a map, STEM.map.npz, or the folder of a sweep")
    if second is not None and kind_of(second) == "map":
        check_not_input(out, *belonging(first), *belonging(second))
        return _written(out, "maps", _two_maps(first, second, recording))
    result = read_map(first)
    check_not_input(out, *belonging(first, result.meta), second, recording)
    text, trace, source, remarks = _one_map(first, result, second, recording, classes)
    found = _written(out, "map", text)
    return replace(found, instances=len(result.instances), trace=trace, recording=source, notes=tuple(remarks))


def _written(out: Path, kind: str, text: str) -> Report:
    replaced = out.is_file()
    with partial_file(out) as partial:
        partial.write_text(text, "utf-8", newline="\n")
    return Report(out, replaced, kind, len(text.encode()), None, None, None, ())


def _sweep(folder: Path, second: Path | None, recording: Path | None) -> str:
    from openvox.apps.reporting.sweep_page import read_sweep, sweep_page

    for extra in (second, recording):
        if extra is not None:
            raise InputError(f"{folder} is the folder of a sweep, whose page takes nothing else; leave out {extra}")
    return sweep_page(folder.resolve().name, read_sweep(folder))


def _two_maps(a: Path, b: Path, recording: Path | None) -> str:
    from openvox.apps.compare import compare
    from openvox.apps.reporting.two_maps import maps_page

    if recording is not None:
        raise InputError(f"{a} and {b} are two maps, whose page has no pictures of a recording; leave out {recording}")
    names = (a.name.removesuffix(SUFFIX), b.name.removesuffix(SUFFIX))
    return maps_page(names, (read_map(a), read_map(b)), compare(a, b))


def _one_map(
    path: Path, result: InstanceMap, trace: Path | None, recording: Path | None, classes: Path | None
) -> tuple[str, Path | None, Path | None, list[str]]:
    """The page, the trace and the recording that it shows, and what is missing."""
    from openvox.apps.categories import categories_of
    from openvox.apps.reporting.crops import crops
    from openvox.apps.reporting.one_map import map_page

    remarks: list[str] = []
    if trace is not None:
        _check_trace(path, result, trace)
    else:
        trace = _trace_beside(path, result)
        if trace is None:
            remarks.append("No statistics of decisions: the trace of this map was not given, and is not beside it.")
    source = recording_of(path, result, recording)
    pieces = {}
    if source is None:
        remarks.append("No pictures of the instances: the recording was not found with the map, or is another one.")
    elif not recording_info(source).has_color:
        remarks.append("No pictures of the instances: the recording has no colour.")
    else:
        pieces = crops(result, source)
    run = _run(trace, result) if trace else []
    title = path.name.removesuffix(SUFFIX)
    categories = categories_of(result, classes)
    return map_page(title, result, map_digest(result), run, pieces, remarks, categories), trace, source, remarks


def _run(trace: Path, result: InstanceMap) -> list[Html]:
    """What the trace tells: where to look first, decisions, growth, and speed from the times beside it."""
    from openvox.apps.explaining.run import read_run
    from openvox.apps.explaining.suspicious import suspicious
    from openvox.apps.reporting.first_look import first_look
    from openvox.apps.reporting.run import confirmed_before, counted, run_section
    from openvox.apps.reporting.speed import speed_section, times_of

    told = read_run(trace)
    return [
        *first_look(suspicious(told, SUSPECTS), {summary.id for summary in result.instances}),
        *run_section(counted(told.frames, confirmed_before(told.frames, result))),
        *speed_section(trace, times_of(trace, trace_info(trace).digest)),
    ]


def _check_trace(path: Path, result: InstanceMap, trace: Path) -> None:
    kind = kind_of(trace)
    if kind != "trace":
        raise InputError(f"{trace} is a {kind}; expected the trace of {path}, or a second map")
    found, expected = trace_info(trace).digest, named_digest(result, "trace")
    if found != expected:
        raise InputError(
            f"{trace} is of another run than {path}: its digest is {found[:12]}, the map names "
            f"{(expected or 'none')[:12]}; give the trace that replay wrote with the map"
        )


def _trace_beside(path: Path, result: InstanceMap) -> Path | None:
    beside = path.with_name(path.name.removesuffix(SUFFIX) + TRACE_SUFFIX)
    try:
        return beside if beside.exists() and trace_info(beside).digest == named_digest(result, "trace") else None
    except InputError:
        return None  # it was not asked for
