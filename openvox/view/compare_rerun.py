"""Two maps side by side in Rerun, what differs in colour."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from openvox.core.types import InstanceMap
from openvox.view.blueprint import Eye, overview
from openvox.view.differences import COLORS, NAMES, SAME, WORDS
from openvox.view.labels import shortened
from openvox.view.rrd_file import rrd_file

APPLICATION = "openvox-compare"
"""Not that of replays: the viewer keeps one layout for all recordings of one application."""
LEGEND = "differences"
CAPTION_LENGTH = 40


@dataclass(frozen=True, eq=False)
class Drawn:
    """One of the two maps."""

    map: InstanceMap
    kinds: NDArray[np.uint8]
    """(N,): the kind of difference at each voxel."""
    title: str


def draw_comparison(a: Drawn, b: Drawn, summary: str, out: Path) -> None:
    """A file (.rrd) with both maps under `a` and `b`, and the summary (Markdown). Instances that differ are named.

    Raises OutputError."""
    with rrd_file(out, APPLICATION, _blueprint(a, b), ("a", "b")) as recording:
        for root, one in (("a", a), ("b", b)):
            _log_map(recording, root, one)
        text = f"### Colours\n\n{_legend()}\n\n### What differs\n\n{summary}"
        recording.log(LEGEND, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def _log_map(recording: rr.RecordingStream, root: str, one: Drawn) -> None:
    colors = np.array(COLORS, np.uint8)
    size = one.map.voxel_size
    for summary in one.map.instances:
        mine = one.map.voxel_instance == summary.id
        index, kinds = one.map.voxel_index[mine], one.kinds[mine]
        if not len(index):
            continue
        cubes = rr.VoxelGridMap(index, voxel_size=[size] * 3, colors=colors[kinds])
        path = f"{root}/instances/{summary.id:04d}"
        recording.log(path, cubes, rr.AnyValues(instance=summary.id, caption=summary.caption), static=True)
        if 2 * np.count_nonzero(kinds != SAME) > len(kinds):
            top = (*((index[:, :2].mean(0) + 0.5) * size).tolist(), float((index[:, 2].max() + 2) * size))
            name = f"{summary.id}: {shortened(summary.caption, CAPTION_LENGTH)}"
            color = COLORS[int(np.bincount(kinds).argmax())]
            point = rr.Points3D([top], labels=[name], colors=[color], radii=[size / 2], show_labels=True)
            recording.log(f"{root}/names/{summary.id:04d}", point, static=True)


def _legend() -> str:
    return "\n".join(f"- **{name}**: {words}" for name, words in zip(NAMES, WORDS, strict=True))


def _blueprint(a: Drawn, b: Drawn) -> rrb.Blueprint:
    """A | B | what differs; both maps from one place."""
    eye = overview(a.map)
    return rrb.Blueprint(
        rrb.Horizontal(
            _spatial("a", a.title, eye),
            _spatial("b", b.title, eye),
            rrb.TextDocumentView(origin=LEGEND, name="What differs"),
            column_shares=[5, 5, 3],
        ),
        rrb.TimePanel(state="hidden"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _spatial(root: str, title: str, eye: Eye) -> rrb.Spatial3DView:
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
    )
    return rrb.Spatial3DView(origin=root, name=title, eye_controls=controls, line_grid=rrb.LineGrid3D(visible=False))
