"""explain: why masks went where they went, the lives of instances and voxels, and what is likely wrong; all from the
trace alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from openvox.apps.explaining.instance import explain_instance
from openvox.apps.explaining.mask import explain_mask
from openvox.apps.explaining.run import read_run
from openvox.apps.explaining.suspicious import suspicious
from openvox.apps.explaining.voxel import explain_voxel
from openvox.apps.info import check_kind
from openvox.core.errors import InputError
from openvox.core.fixedpoint import Q20
from openvox.formats.trace import TraceFrame, read_trace, trace_info

TOP = 20
SHARES = ("s_geo", "s_fea", "a", "threshold", "visibility")


def explain(
    trace: Path,
    *,
    frame: int | None = None,
    mask: int | None = None,
    instance: int | None = None,
    at: Sequence[float] | None = None,
    top: int = TOP,
) -> dict[str, Any]:
    """What the trace tells about one thing: a mask of a frame, a frame, an instance, a voxel (`at`, metres); without
    any of them the `top` decisions most likely wrong. Raises InputError."""
    check_kind(trace, "trace")
    if frame is not None and mask is None:
        return explain_frame(trace, frame)
    run = read_run(trace)
    if frame is not None and mask is not None:
        return explain_mask(run, frame, mask)
    if instance is not None:
        return explain_instance(run, instance)
    return suspicious(run, top) if at is None else explain_voxel(run, at)


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
