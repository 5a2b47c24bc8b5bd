"""What doctor says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Code = Literal[
    "depth_unit",
    "pose_inverted",
    "pose_axes",
    "pose_time",
    "registration",
    "stamps",
    "clock",
    "black",
    "depth_missing",
    "intrinsics",
    "masks",
]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that looks wrong."""

    code: Code
    what: str
    """A sentence."""
    figure: str
    """What was measured."""
    cause: str
    """What it most likely comes from."""
    cure: str
    """What to do, with the option that does it."""
