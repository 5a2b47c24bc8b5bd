"""query, with its answers shown in the map: as a picture, or in a file for Rerun."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from openvox.apps.query import query
from openvox.core.errors import OutputError
from openvox.formats.map_npz import read_map

if TYPE_CHECKING:
    from openvox.view.answers import Answered


def query_and_show(
    map_file: Path,
    texts: Sequence[str],
    *,
    top: int = 3,
    models: Path | None = None,
    png: Path | None = None,
    rerun: Path | None = None,
) -> dict[str, Any]:
    """What `query` finds, and `outputs`: the files `png` and `rerun` that show it. Raises InputError, OutputError."""
    for name, path, ending in (("--png", png, ".png"), ("--rerun", rerun, ".rrd")):
        if path is not None and path.suffix.lower() != ending:
            raise OutputError(f"{name} {path} would be overwritten with a picture; let its name end with {ending}")
    found = query(map_file, texts, top=top, models=models)
    result = read_map(map_file)
    answered = [_answered(asked) for asked in found["queries"]]
    if png is not None:
        from openvox.view.answers import draw_answers  # cv2, numba

        draw_answers(png, result, answered)
    if rerun is not None:
        from openvox.apps.categories import categories_of
        from openvox.view.map_scene import draw_map_file  # rerun

        draw_map_file(rerun, result, categories_of(result, None), answered)
    outputs = {name: None if path is None else str(path) for name, path in (("png", png), ("rerun", rerun))}
    return {**found, "outputs": outputs}


def _answered(asked: dict[str, Any]) -> Answered:
    from openvox.view.answers import Answered

    answers = asked["answers"]
    names = tuple(f"({one['score']:.2f}) {one['caption'] or 'no caption'}" for one in answers)
    return Answered(asked["text"], asked["found"], tuple(one["instance"] for one in answers), names)
