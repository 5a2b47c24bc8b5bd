"""How many things can be done at a time."""

from __future__ import annotations

import os
import sys


def cores() -> int:
    """Cores that this process may use; on systems that do not tell, all."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
