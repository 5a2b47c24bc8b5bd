#!/usr/bin/env python3
"""What doctor says of good recordings, of pieces of them, and of recordings that were broken in every way it knows.

    .venv/bin/python tools/bench/doctor.py REC.mcap...

Prints a table of false alarms, and one of the breaks (tests/broken.py): which code was given, and the figure.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from broken import BREAKS, broken

from openvox.apps.doctor import examined
from openvox.apps.examining.finding import Finding
from openvox.core.types import Frame
from openvox.formats.recording import read_frames

PIECES = ((0, 20), (7, 25), (30, 30), (45, 60), (60, 20), (75, 40), (20, 50))
"""First frame and length."""


def findings(frames: Sequence[Frame]) -> tuple[Finding, ...]:
    return examined(Path("frames"), "recording", [frames], len(frames), None).findings


def said(found: tuple[Finding, ...]) -> str:
    return "; ".join(f"{one.code} ({one.figure})" for one in found) or "-"


def main(paths: Sequence[Path]) -> None:
    scenes = {path.stem: list(read_frames(path, truth=False)) for path in paths}
    print("| good | frames | seconds | doctor |\n|---|---|---|---|")
    for name, frames in scenes.items():
        for first, length in ((0, len(frames)), *PIECES):
            begun = time.monotonic()
            found = findings(frames[first : first + length])
            print(f"| {name} | {first}-{first + length} | {time.monotonic() - begun:.1f} | {said(found)} |", flush=True)
    print("\n| broken | expected | right | doctor |\n|---|---|---|---|")
    for what, (code, _) in BREAKS.items():
        for name, frames in scenes.items():
            found = findings(broken(frames, what))
            right = {one.code for one in found} == {code}
            print(f"| {what}, {name} | {code} | {'yes' if right else 'NO'} | {said(found)} |", flush=True)


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
