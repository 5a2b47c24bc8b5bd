"""view: any file of openvox in Rerun, on the screen, in a browser on this machine, or as an .rrd."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from openvox.apps.info import is_rrd, kind_of
from openvox.apps.joined import joined_frames
from openvox.apps.origin import belonging, named_digest
from openvox.apps.retrace import Pictures, steps_of
from openvox.core.errors import InputError, OutputError
from openvox.core.types import Frame, InstanceMap, Mask
from openvox.formats.atomic import check_not_input, check_writable
from openvox.formats.growing import final_name, finished_or_not
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.map_npz import read_map
from openvox.formats.perception import SUFFIX as PERCEPTION_SUFFIX
from openvox.formats.perception import perception_info
from openvox.formats.recording import recording_info
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.trace import TraceInfo, trace_info

Notice = Callable[[str], None]
Progress = Callable[[int, int], None]


def view(
    files: Sequence[Path],
    *,
    recording: Path | None = None,
    classes: Path | None = None,
    save: Path | None = None,
    web: bool = False,
    bind: str = "127.0.0.1",
    port: int = 0,
    notice: Notice = lambda text: None,
    ready: Callable[[str], None] = lambda url: None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Show files until the window is closed or Ctrl-C; `save`: write the one file as .rrd instead.

    recording: of the traces, where it is not where they name it.
    classes: names for the categories of maps. ready: told the URL of `web`. Returns `files` with
    their kinds, and `output`. Raises InputError, OutputError."""
    from openvox.view.rrd_contents import check_readable
    from openvox.view.viewer import has_screen, open_window, serve_web

    kinds = [kind(path) for path in files]
    if classes is not None and "map" not in kinds:
        raise InputError(f"--classes {classes} has no effect here, because only maps show categories; leave it out")
    about = {"files": [{"path": str(path), "kind": one} for path, one in zip(files, kinds, strict=True)]}
    if save is not None:
        if len(files) != 1:
            raise InputError(f"--save writes one file, {len(files)} were given; save them one by one")
        if save.suffix.lower() != ".rrd":
            raise OutputError(f"{save} would be a file for Rerun under another name; let it end with .rrd")
        check_writable(save)
        replaced = save.exists()
        as_rrd(files[0], save, recording, notice, classes, progress)
        return {**about, "output": str(save), "replaced": replaced}
    for path, one in zip(files, kinds, strict=True):
        if one == "rrd":
            check_readable(path)
    if not web and not has_screen():
        open_window([])  # says so, before anything is drawn
    with tempfile.TemporaryDirectory(prefix="openvox-view-") as folder:
        shown = [
            path
            if one == "rrd"
            else as_rrd(path, Path(folder) / f"{number} {path.name}.rrd", recording, notice, classes, progress)
            for number, (path, one) in enumerate(zip(files, kinds, strict=True), start=1)
        ]
        if web:
            serve_web(shown, bind, port, ready)
        else:
            open_window(shown)
    return {**about, "output": None, "replaced": False}


def kind(path: Path) -> str:
    """recording, perception, map, trace or rrd. Raises InputError."""
    if is_rrd(path):
        return "rrd"
    try:
        return kind_of(path)
    except InputError as error:
        raise InputError(
            f"{path} is no recording, perception, map, trace or .rrd, which are what can be shown ({error})"
        ) from None


def as_rrd(
    path: Path,
    out: Path,
    recording: Path | None = None,
    notice: Notice = lambda text: None,
    classes: Path | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write what a file holds as an .rrd; returns it. recording: where a trace or perception does not find its own.

    classes: a file of names for the categories of a map, which otherwise come from its captions.
    notice: told what is missing from the picture. progress: of a trace's frames. Raises InputError, OutputError."""
    check_not_input(out, *belonging(path), recording)
    found = kind(path)
    if found == "trace":
        _draw_trace(path, out, recording, notice, progress)
    elif found == "map":
        from openvox.apps.categories import categories_of
        from openvox.view.map_scene import draw_map_file

        result = read_map(path)
        draw_map_file(out, result, categories_of(result, classes))
    elif found == "rrd":
        raise InputError(f"{path} is an .rrd already; copy it")
    else:
        from openvox.view.recording_scene import draw_recording

        with closing(_seen(path, found, recording, notice)) as frames:
            draw_recording(out, frames)
    return out


def _seen(
    path: Path, found: str, recording: Path | None, notice: Notice
) -> Generator[tuple[Frame, tuple[Mask, ...] | None], None, None]:
    """Frames of a recording with their masks; path: the recording, or a perception that names it."""
    perception: Path | None = path
    if found == "perception":
        source = recording or finished_or_not(path.parent / perception_info(path).recording)
    else:
        source = path
        beside = finished_or_not(final_name(path).with_suffix(PERCEPTION_SUFFIX))
        perception = beside if beside.exists() else None
        if perception is None:
            notice(f"{beside} is not there: shown without masks")
    return joined_frames(source, perception)


def _draw_trace(path: Path, out: Path, recording: Path | None, notice: Notice, progress: Progress | None) -> None:
    """The run as `replay --rerun` would have shown it, without mapping again."""
    from openvox.view.rerun_observer import RerunObserver

    info = trace_info(path)
    pictures = _pictures(info, recording, notice)
    check_not_input(out, pictures.recording, pictures.perception)
    result = _map_of(info)
    with RerunObserver(
        out,
        voxel_size=result.voxel_size,
        images="jpeg" if pictures.perception is not None else "none",
        camera=pictures.recording is not None,
    ) as observer:
        for done, step in enumerate(steps_of(path, pictures), start=1):
            observer.on_step(step)
            if progress:
                progress(done, info.frames)
        # what finishing dropped stands among the events of the last frame already
        observer.close(replace(result, events=()))


def _map_of(info: TraceInfo) -> InstanceMap:
    """The map that the run ended with, which lies beside its trace."""
    path = info.path.with_name(info.path.name.removesuffix(TRACE_SUFFIX) + MAP_SUFFIX)
    if not path.exists():
        raise InputError(f"{info.path}: its map {path} is not there; put it beside the trace, or replay again")
    result = read_map(path)
    if named_digest(result, "trace") != info.digest:
        raise InputError(f"{path} is of another run than {info.path}; replay again")
    return result


def _pictures(info: TraceInfo, recording: Path | None, notice: Notice) -> Pictures:
    """Recording and perception where the trace names them, if they are still those of the run."""
    seen = _source(info, "recording", recording, lambda path: recording_info(path).digest, notice)
    found = _source(info, "perception", None, lambda path: perception_info(path).digest, notice) if seen else None
    return Pictures(seen, found)


def _source(
    info: TraceInfo, name: str, given: Path | None, digest_of: Callable[[Path], str], notice: Notice
) -> Path | None:
    try:
        relative, digest = info.run["sources"][name]
        path = given or info.path.parent / Path(str(relative))
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{info.path} does not name its {name}; replay again") from None
    if not path.exists() and given is None:
        notice(f"the {name} {path} is not there: shown without pictures")
        return None
    if digest_of(path) != digest:
        if given is not None:
            raise InputError(f"{path} is another {name} than that of {info.path}")
        notice(f"{path} is another {name} than that of {info.path}: shown without pictures")
        return None
    return path
