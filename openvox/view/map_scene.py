"""A finished map as Rerun shows it: instances in their colours or by confidence, and a list of what is there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from openvox.core.colors import instance_color
from openvox.core.types import InstanceMap
from openvox.view import entities
from openvox.view.blueprint import overview
from openvox.view.decision_table import escaped
from openvox.view.labels import BACKGROUND
from openvox.view.rrd_file import rrd_file

APPLICATION = "openvox map"
STRUCTURE = f"{entities.WORLD}/structure"
TABLE = "instances/table"


def draw_map_file(path: Path, result: InstanceMap) -> None:
    """Write an .rrd of a map, on no timeline. Raises OutputError."""
    with rrd_file(path, APPLICATION, _layout(result)) as stream:
        edge = [result.voxel_size] * 3
        order = np.argsort(result.voxel_instance, kind="stable")
        for summary in result.instances:
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
        stream.log(TABLE, rr.TextDocument(_table(result), media_type=rr.MediaType.MARKDOWN), static=True)


def _table(result: InstanceMap) -> str:
    """One row an instance, by id."""
    rows = ["| instance | caption | state | voxels | confidence | frames |", "|--:|---|---|--:|--:|--:|"]
    for summary, confidence in zip(result.instances, result.instance_confidence.tolist(), strict=True):
        caption = escaped(" ".join(summary.caption.split()))
        rows.append(
            f"| {summary.id} | {caption} | {summary.state} | {summary.voxels} | {confidence:.2f} "
            f"| {summary.observations} |"
        )
    return "\n".join(rows)


def _layout(result: InstanceMap) -> rrb.Blueprint:
    eye = overview(result)
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
    )
    views = [
        rrb.Spatial3DView(
            origin=entities.WORLD, contents=[f"+ {path}/**" for path in shown], name=name, eye_controls=controls
        )
        for name, shown in (
            ("Map, coloured by instance", [entities.INSTANCES]),
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
