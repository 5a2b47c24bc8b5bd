"""explain: why each mask of a frame went where it went, from the trace alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.core.fixedpoint import Q20
from openvox.formats.trace import TraceFrame, read_trace, trace_info

SHARES = ("s_geo", "s_fea", "a", "threshold", "visibility")


def explain_frame(trace: Path, frame: int) -> dict[str, Any]:
    """The decisions and events of one frame, scores as numbers in [0, 1]. Raises InputError."""
    found = next(iter(read_trace(trace, frame)), None)
    if found is None or found.frame != frame:
        raise InputError(
            f"{trace}: frame {frame} was not mapped; it holds {trace_info(trace).frames} frames"
            + (f", the next is {found.frame}" if found else "")
        )
    return {
        "frame": found.frame,
        "stamp_ns": found.stamp_ns,
        "looked": found.looked,
        "decisions": [_in_numbers(decision) for decision in found.decisions],
        "events": _events(found),
    }


def _in_numbers(decision: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **decision,
        **{name: decision[name] / Q20 for name in SHARES},
        "credibility": decision["credibility"] / 4096,
        "candidates": [
            {**candidate, **{name: candidate[name] / Q20 for name in ("s_geo", "s_fea", "a")}}
            for candidate in decision["candidates"]
        ],
    }


def _events(found: TraceFrame) -> list[dict[str, Any]]:
    return [
        {"kind": event.kind, "instance": event.instance, "others": list(event.others), "text": event.text}
        for event in found.events
    ]
