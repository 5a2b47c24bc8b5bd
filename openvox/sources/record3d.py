"""Record3D's `.r3d`: not read, since no well-kept decoder of its packed depth exists; the sentence says what to do."""

from __future__ import annotations

from pathlib import Path

from openvox.core.errors import InputError
from openvox.sources.source import Options, Source

WANTED = ("*.r3d",)


def missing(path: Path, options: Options) -> list[str]:
    """What is missing for it to be such a file."""
    return [] if path.suffix == ".r3d" else ["a .r3d file"]


def read(path: Path, options: Options) -> Source:
    """Always an InputError."""
    raise InputError(
        f"{path} packs its depth with LZFSE, which openvox does not read: unpack it (record3d and pyliblzfse on a Mac) "
        "into color/, depth/ (16-bit PNG, millimetres), camera_intrinsic.json and trajectory.log, as docs/sources.md "
        "shows for open3d"
    )
