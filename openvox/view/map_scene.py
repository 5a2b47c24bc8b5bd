"""A finished map as Rerun shows it: coloured by instance, category or confidence, and a list of what is there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from openvox.core.colors import category_colors, instance_color
from openvox.core.types import InstanceMap
from openvox.view import entities
from openvox.view.answers import REST, Answered
from openvox.view.blueprint import Eye, controls, overview
from openvox.view.decision_table import escaped
from openvox.view.labels import BACKGROUND, shortened
from openvox.view.rrd_file import rrd_file

APPLICATION = "openvox map"
STRUCTURE = f"{entities.WORLD}/structure"
TABLE = "instances/table"


def draw_map_file(
    path: Path, result: InstanceMap, categories: Sequence[str], answered: Sequence[Answered] = ()
) -> None:
    """Write an .rrd of a map, on no timeline. Raises OutputError.

    categories: one an instance. answered: questions, each a view of its own before the others."""
    with rrd_file(path, APPLICATION, map_layout(overview(result), answered)) as stream:
        edge = [result.voxel_size] * 3
        order = np.argsort(result.voxel_instance, kind="stable")
        colors = category_colors(categories)
        for summary, category, color in zip(result.instances, categories, colors, strict=True):
            first, last = np.searchsorted(result.voxel_instance, [summary.id, summary.id + 1], sorter=order)
            mine = order[first:last]
            index = result.voxel_index[mine]
            if not len(index):
                continue
            data = rr.AnyValues(
                instance=pa.array([summary.id], pa.int32()), caption=pa.array([summary.caption], pa.string())
            )
            cubes = rr.VoxelGridMap(index, voxel_size=edge, colors=[instance_color(summary.id)])
            stream.log(entities.instance_path(summary.id), cubes, data, static=True)
            of_category = rr.VoxelGridMap(index, voxel_size=edge, colors=[color])
            about = rr.AnyValues(category=pa.array([category], pa.string()))
            stream.log(entities.category_path(summary.id), of_category, data, about, static=True)
            shades = rr.VoxelGridMap(
                index,
                voxel_size=edge,
                values=result.voxel_confidence[mine],
                value_range=(0.0, 1.0),
                colormap=rr.components.Colormap.Viridis,
            )
            stream.log(entities.confidence_path(summary.id), shades, data, static=True)
        walls = result.voxel_index[result.voxel_instance == 0]
        if len(walls):
            stream.log(STRUCTURE, rr.VoxelGridMap(walls, voxel_size=edge, colors=[BACKGROUND]), static=True)
        for number, one in enumerate(answered):
            _log_answers(stream, number, one, result)
        stream.log(TABLE, rr.TextDocument(_table(result, categories), media_type=rr.MediaType.MARKDOWN), static=True)


def _log_answers(stream: rr.RecordingStream, number: int, one: Answered, result: InstanceMap) -> None:
    """The answers of a question in its colours, and all other instances together."""
    others = (result.voxel_instance > 0) & ~np.isin(result.voxel_instance, one.instances)
    shown = {"rest": (others, REST)}
    for instance in one.instances:
        shown[f"{instance:04d}"] = (result.voxel_instance == instance, one.color(instance))
    for name, (mine, color) in shown.items():
        if mine.any():
            cubes = rr.VoxelGridMap(result.voxel_index[mine], voxel_size=[result.voxel_size] * 3, colors=[color])
            stream.log(entities.answer_path(number, name), cubes, static=True)


def _table(result: InstanceMap, categories: Sequence[str]) -> str:
    """One row an instance, by id."""
    rows = ["| instance | caption | category | state | voxels | confidence | frames |", "|--:|---|---|---|--:|--:|--:|"]
    for summary, category, confidence in zip(
        result.instances, categories, result.instance_confidence.tolist(), strict=True
    ):
        caption, kind = (escaped(" ".join(text.split())) for text in (summary.caption, category))
        rows.append(
            f"| {summary.id} | {caption} | {kind} | {summary.state} | {summary.voxels} | {confidence:.2f} "
            f"| {summary.observations} |"
        )
    return "\n".join(rows)


def map_layout(eye: Eye | None = None, answered: Sequence[Answered] = ()) -> rrb.Blueprint:
    """The ways to colour the map, in tabs, after its answers | the list of instances. eye: where it is seen from."""
    views = [
        rrb.Spatial3DView(
            origin=entities.WORLD, contents=[f"+ {path}/**" for path in shown], name=name, eye_controls=controls(eye)
        )
        for name, shown in (
            *(
                (f"Answers: {shortened(one.text, 30)}", [f"{entities.ANSWERS}/{number:02d}"])
                for number, one in enumerate(answered)
            ),
            ("Map, coloured by instance", [entities.INSTANCES]),
            ("Map, coloured by category", [entities.CATEGORIES]),
            ("Map, coloured by confidence", [entities.CONFIDENCE]),
            ("Map with what belongs to no instance", [entities.INSTANCES, STRUCTURE]),
        )
    ]
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Tabs(*views), rrb.TextDocumentView(origin=TABLE, name="Instances"), column_shares=[2, 1]),
        rrb.TimePanel(state="hidden"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
