"""What tests let a process of its own do; a light module, as every such process imports it."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

from openvox.core.errors import InputError


def double(number: int) -> int:
    return 2 * number


def noted(task: tuple[Path, int]) -> int:
    """The process that did it. Leaves a mark each time; 2 dies, 3 raises, 4 prints."""
    folder, number = task
    (folder / f"{number}-{time.monotonic_ns()}").touch()
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 3:
        raise InputError("three is no number")
    if number == 4:
        sys.stdout.write("talk that must not stand in the answer\n")
    return os.getpid()


def endless(mark: Path) -> None:
    """Writes its process id, and sleeps."""
    (mark.parent / "writing").write_text(str(os.getpid()))
    (mark.parent / "writing").rename(mark)
    time.sleep(600)
