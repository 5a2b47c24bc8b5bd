"""How far a long command is, on stderr, and only where a person watches."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

REDRAW_SECONDS = 0.1


def progress(what: str, unit: str = "frames") -> Callable[[int, int], None] | None:
    """A callback (done, total) that redraws one line with rate and time left; None if stderr is no terminal.

    total: 0 if unknown. The line is wiped when done reaches total."""
    if not sys.stderr.isatty():
        return None
    begun = time.monotonic()
    drawn = -REDRAW_SECONDS

    def show(done: int, total: int) -> None:
        nonlocal drawn
        now = time.monotonic()
        finished = 0 < total <= done
        if finished or now - drawn >= REDRAW_SECONDS:
            drawn = now
            text = "" if finished else line(what, done, total, now - begun, unit)
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)

    return show


def line(what: str, done: int, total: int, seconds: float, unit: str = "frames") -> str:
    """As in `mapping  37/180 frames  91.2/s  1.6 s left`."""
    rate = done / seconds if seconds > 0 else 0.0
    left = f"  {(total - done) / rate:.0f} s left" if total and rate else ""
    return f"{what}  {done}{f'/{total}' if total else ''} {unit}  {rate:.1f}/s{left}"
