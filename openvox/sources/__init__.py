"""Sources of frames: one file a format, a table of them, and a guess from what a folder holds."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.sources.source import Dropped, Options, Source

__all__ = ["FORMATS", "Dropped", "Source", "open_source"]

FORMATS = {"scannet": "openvox.sources.scannet", "replica": "openvox.sources.replica"}
"""Format to module; each has WANTED, missing(folder) and read(folder, options)."""


def open_source(
    path: Path,
    format: str = "auto",  # noqa: A002 (the option's name)
    fps: float = 30.0,
    origin: tuple[int, int, int] = (0, 0, 0),
    start: int | None = None,
    end: int | None = None,
    stride: int = 1,
) -> Source:
    """Opens a folder of frames.

    format: a name of FORMATS, or auto: guessed. fps: frame rate where the source has no stamps. origin: whole metres,
    subtracted from every position. start, end (exclusive), stride: frame numbers. Raises InputError, here for what is
    missing, while iterating for files that are not what they should be."""
    options = Options(fps, origin, start, end, stride)
    if not path.is_dir():
        raise InputError(
            f"{path} is {'a file' if path.exists() else 'not there'}; expected a folder of exported frames"
        )
    if format not in ("auto", *FORMATS):
        raise InputError(f"there is no format {format!r}; known: auto, {', '.join(FORMATS)}")
    lacking: list[str] = []
    for name, module in FORMATS.items():
        if format in ("auto", name):
            loader: Any = import_module(module)
            missing = loader.missing(path)
            if not missing:
                source: Source = loader.read(path, options)
                return source
            lacking.append(f"{name} wants {' '.join(loader.WANTED)} and lacks {' '.join(missing)}")
    raise InputError(f"{path} holds no frames that can be read: {'; '.join(lacking)}")
