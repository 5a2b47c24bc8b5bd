"""shot: a picture of any file of openvox as Rerun shows it, without a screen."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from openvox.apps.origin import belonging
from openvox.apps.view import Notice, Progress, as_rrd, kind
from openvox.core.errors import OutputError
from openvox.formats.atomic import check_not_input, check_writable
from openvox.formats.growing import finished_or_not
from openvox.formats.perception import perception_info
from openvox.formats.recording import recording_info
from openvox.formats.trace import read_trace


def shot(
    path: Path,
    out: Path,
    *,
    frame: int | None = None,
    view: str | None = None,
    size: tuple[int, int] = (1600, 900),
    recording: Path | None = None,
    notice: Notice = lambda text: None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a PNG of a recording, map, trace or .rrd; frame: None = the last. view: None = the whole layout.

    size: of the picture, pixels. Returns `output`, `replaced`, `kind`, `frame`, `view` and `size` of the picture.
    Raises InputError, OutputError."""
    from openvox.view.screenshot import check_machine, take_shot

    check_not_input(out, *belonging(path), recording)
    if out.suffix.lower() != ".png":
        raise OutputError(f"{out} would be a PNG under another name; let it end with .png")
    found, replaced = kind(path), out.exists()
    check_writable(out)
    _check_choice(path, found, frame, view, recording)
    check_machine()
    with tempfile.TemporaryDirectory(prefix="openvox-shot-") as folder:
        rrd = (
            path
            if found == "rrd"
            else as_rrd(path, Path(folder) / f"{path.stem}.rrd", recording, notice, progress=progress)
        )
        shown = take_shot(rrd, out, name=path.name, frame=frame, view=view, size=size)
    return {"output": str(out), "replaced": replaced, "kind": found, **shown}


def _check_choice(path: Path, found: str, frame: int | None, view: str | None, recording: Path | None) -> None:
    """Before anything is drawn, what can be known before: of an .rrd only the viewer knows. Raises InputError."""
    from openvox.view.screenshot import check_frame, chosen_view

    if found == "rrd":
        from openvox.view.rrd_contents import check_readable

        check_readable(path)
        return
    if view is not None:
        chosen_view(path.name, view, _views(found))
    if frame is not None:
        check_frame(path.name, frame, _frames(path, found, recording))


def _views(found: str) -> list[str]:
    """Names of the views that a file of this kind is shown with."""
    from openvox.view.blueprint import blueprint, view_names
    from openvox.view.map_scene import map_layout
    from openvox.view.recording_scene import recording_layout

    return view_names(blueprint() if found == "trace" else map_layout() if found == "map" else recording_layout())


def _frames(path: Path, found: str, recording: Path | None) -> tuple[int, int] | None:
    if found == "map":
        return None
    if found == "trace":
        numbers = [told.frame for told in read_trace(path)]
        return (min(numbers), max(numbers)) if numbers else None
    if found == "perception":
        path = recording or finished_or_not(path.parent / perception_info(path).recording)
    info = recording_info(path)
    return info.first, info.last
