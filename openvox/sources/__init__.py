"""Sources of frames: one file a format, a table of them, and a guess from what a folder holds."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.sources.corrections import corrected
from openvox.sources.poses import with_own_poses
from openvox.sources.source import Dropped, Options, Source, StampError

__all__ = ["FORMATS", "Dropped", "Options", "Source", "StampError", "open_source"]

FORMATS = {
    "ros": "openvox.sources.ros",
    "scannet": "openvox.sources.scannet",
    "replica": "openvox.sources.replica",
    "sens": "openvox.sources.sens",
    "tum": "openvox.sources.tum",
    "7scenes": "openvox.sources.sevenscenes",
    "open3d": "openvox.sources.open3d",
    "stray": "openvox.sources.stray",
    "foxglove": "openvox.sources.foxglove",
    "record3d": "openvox.sources.record3d",
}
"""Format to module; each has WANTED, missing(path) and read(path, options)."""


def open_source(path: Path, format: str = "auto", **given: Any) -> Source:  # noqa: A002 (the option's name)
    """Opens a folder of frames, or a robot's log.

    format: a name of FORMATS, or auto: guessed. given: fields of Options. Raises InputError, here for what is missing,
    while iterating for files that are not what they should be."""
    options = Options(**given)
    if not path.exists():
        raise InputError(f"{path} is not there; expected a folder of frames, or a robot's log")
    if format not in ("auto", *FORMATS):
        raise InputError(f"there is no format {format!r}; known: auto, {', '.join(FORMATS)}")
    wanted: list[str] = []
    for name in FORMATS if format == "auto" else (format,):
        loader: Any = import_module(FORMATS[name])
        missing = loader.missing(path, options)
        if not missing:
            source: Source = loader.read(path, options)
            own = options.poses is not None or options.color_from_depth is not None
            return corrected(with_own_poses(source, options) if own else source, options)
        lacks = f" and lacks {' '.join(missing)}" if len(missing) < len(loader.WANTED) or format != "auto" else ""
        wanted.append(f"{name} wants {' '.join(loader.WANTED)}{lacks}")
    what = f"{path} is a file that" if path.is_file() else str(path)
    raise InputError(f"{what} holds no frames that can be read: {'; '.join(wanted)}")
