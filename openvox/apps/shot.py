"""shot: a picture of any file of openvox as Rerun shows it, without a screen."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from openvox.apps.origin import belonging
from openvox.apps.view import as_rrd, kind
from openvox.formats.atomic import check_not_input


def shot(
    path: Path,
    out: Path,
    *,
    frame: int | None = None,
    view: str | None = None,
    size: tuple[int, int] = (1600, 900),
    recording: Path | None = None,
    notice: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Write a PNG of a recording, map, trace or .rrd; frame: None = the last. view: None = the whole layout.

    size: of the window, pixels. Returns `output`, `replaced`, `kind`, `frame`, `view` and `size` of the picture.
    Raises InputError, OutputError."""
    from openvox.view.screenshot import check_machine, take_shot

    check_not_input(out, *belonging(path), recording)
    found, replaced = kind(path), out.exists()
    check_machine()
    with tempfile.TemporaryDirectory(prefix="openvox-shot-") as folder:
        rrd = path if found == "rrd" else as_rrd(path, Path(folder) / f"{path.stem}.rrd", recording, notice)
        shown = take_shot(rrd, out, frame=frame, view=view, size=size)
    return {"output": str(out), "replaced": replaced, "kind": found, **shown}
