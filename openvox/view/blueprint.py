"""The layout that travels in a Rerun recording: map, pictures, decisions, statistics; opens on the frame timeline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from openvox.core.types import InstanceMap, Intrinsics
from openvox.view import entities
from openvox.view.best_views import WIDTH
from openvox.view.lives import COLORS
from openvox.view.viewpoint import best_azimuth, centres, from_above

MOST_BITS = 1.5
"""Entropy with the brightest colour; 1 bit = two instances with as many votes each."""
VIEW = Intrinsics(500, 750, 720.0, 720.0, 249.5, 374.5)
"""About the 3D view in a window of 1600 x 900, with the viewer's angle of 55 degrees."""


@dataclass(frozen=True, slots=True)
class Eye:
    """Where the 3D views look from and to, metres, world."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]


def overview(result: InstanceMap) -> Eye:
    """A place above the finished map from which all instances are seen."""
    instances = result.voxel_instance > 0
    points = centres(result.voxel_index[instances], result.voxel_size)
    azimuth = best_azimuth(result, lambda _map, _azimuth: instances)
    pose = from_above(points, VIEW, azimuth)
    position, forward = pose[:3, 3], pose[:3, 2]
    target = position + forward * float(((points - position) @ forward).mean())
    return Eye(tuple(position.tolist()), tuple(target.tolist()))


def blueprint(eye: Eye | None = None, *, pictures: bool = True, pictured: Sequence[int] = ()) -> rrb.Blueprint:
    """3D map | detected above rendered masks | this frame's decisions above what happened over time; panels collapsed.

    pictures: whether there is a column for them, and what is under each mask in space. pictured: instances
    that have a picture beside their voxels, which a 3D view is not to draw."""
    columns = [_maps(eye, pictures, pictured), *([_pictures()] if pictures else []), _numbers()]
    return _side_by_side(columns, pictures)


def opening(*, pictures: bool) -> rrb.Blueprint:
    """The front views alone: what is seen of a long file until the layout has come, which stands at its end.

    A whole layout takes 160 kB."""
    shown = [f"+ {path}/**" for path in (entities.CAMERA, entities.TRAJECTORY, entities.INSTANCES, entities.TOUCHED)]
    columns = [
        rrb.Spatial3DView(origin=entities.WORLD, contents=shown, name="Instances"),
        *([rrb.Spatial2DView(origin=entities.COLOR, name="Detected masks")] if pictures else []),
        rrb.TextDocumentView(origin=entities.DECISION_TABLE, name="Decisions of this frame"),
    ]
    return _side_by_side(columns, pictures)


def _side_by_side(columns: Sequence[Any], pictures: bool) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=[11, 8, 15] if pictures else [1, 1]),
        rrb.TimePanel(state="collapsed", timeline=entities.FRAME),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def view_names(layout: rrb.Blueprint) -> list[str]:
    """Names of all views of a layout, those behind tabs, too."""
    names: list[str] = []
    waiting: list[Any] = [layout.root_container]
    while waiting:
        part = waiting.pop()
        if isinstance(part, rrb.View):
            names.append(str(part.name))
        else:
            waiting.extend(part.contents)
    return sorted(names)


def _maps(eye: Eye | None, pictures: bool, pictured: Sequence[int]) -> rrb.Tabs:
    maps = rr.components.Colormap
    shown = [entities.INSTANCES, entities.CAPTIONS, entities.TOUCHED, entities.DETECTED]
    return rrb.Tabs(
        _spatial("Instances", shown, eye, pictured=pictured),
        _spatial("Confidence", [entities.CONFIDENCE, entities.CAPTIONS], eye, _shades(1.0, maps.Viridis)),
        _spatial("Entropy", [entities.ENTROPY, entities.CAPTIONS], eye, _shades(MOST_BITS, maps.Magma)),
        *([_spatial("Masks", [entities.REGIONS, entities.TOUCHED, entities.DETECTED], eye)] if pictures else []),
    )


def _pictures() -> rrb.Vertical:
    return rrb.Vertical(
        rrb.Tabs(
            rrb.Spatial2DView(
                origin=entities.COLOR, contents=[f"{entities.DETECTED}/**", entities.MASK_NAMES], name="Detected masks"
            ),
            rrb.Spatial2DView(origin=entities.DEPTH, name="Depth, m"),
            rrb.Spatial2DView(
                origin=entities.BEST_VIEWS,
                name="Best views",
                visual_bounds=rrb.VisualBounds2D(x_range=(0, WIDTH), y_range=(0, WIDTH)),
            ),
        ),
        rrb.Tabs(
            rrb.Spatial2DView(origin=entities.RENDERED, name="The map from the same pose"),
            rrb.Spatial2DView(origin=entities.RENDERED_CONFIDENCE, name="Its confidence"),
        ),
    )


def _numbers() -> rrb.Vertical:
    configuration = rr.StateConfiguration(values=list(COLORS), labels=list(COLORS), colors=list(COLORS.values()))
    return rrb.Vertical(
        rrb.Tabs(
            rrb.TextDocumentView(origin=entities.DECISION_TABLE, name="Decisions of this frame"),
            rrb.GraphView(origin=entities.GRAPH, name="As a graph"),
            rrb.TextDocumentView(origin=entities.INSTANCE_TABLE, name="All instances"),
        ),
        rrb.Tabs(
            rrb.TextLogView(origin=entities.EVENTS, name="Events", columns=_when_and_what()),
            rrb.StateTimelineView(origin=entities.LIVES, name="Lives", defaults=[configuration]),
            rrb.TimeSeriesView(origin=entities.MARGINS, name="Margins"),
            rrb.TimeSeriesView(origin=entities.INSTANCE_COUNT, name="Number of instances"),
            rrb.TimeSeriesView(origin=entities.VOXEL_COUNT, name="Number of voxels"),
            rrb.TimeSeriesView(origin=entities.MILLISECONDS, name="Milliseconds"),
        ),
        row_shares=[3, 2],
    )


def _shades(most: float, colormap: rr.components.Colormap) -> rr.VoxelGridMap:
    """How values from 0 to `most` are coloured, said once for all instances of a view: in each it would cost 1 kB."""
    return rr.VoxelGridMap.from_fields(value_range=(0.0, most), colormap=colormap)


def _spatial(
    name: str, shown: Sequence[str], eye: Eye | None, *defaults: rr.VoxelGridMap, pictured: Sequence[int] = ()
) -> rrb.Spatial3DView:
    overrides: dict[Any, Any] = {
        entities.TRAJECTORY: _from_the_start(),
        entities.CAPTIONS: rrb.EntityBehavior(visible=False),
        **{entities.instance_path(instance): rr.VoxelGridMap.from_fields().visualizer() for instance in pictured},
    }
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        contents=[f"+ {path}/**" for path in (entities.CAMERA, entities.TRAJECTORY, *shown)],
        name=name,
        defaults=defaults or None,
        overrides=overrides,
        eye_controls=controls(eye),
    )


def controls(eye: Eye | None) -> rrb.EyeControls3D | None:
    """An eye for Rerun; None: it chooses one."""
    if eye is None:
        return None
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
    )


def _when_and_what() -> rrb.TextLogColumns:
    kinds = rrb.encodings.TextLogColumnKind
    return rrb.TextLogColumns(
        timeline_columns=[entities.FRAME],
        text_log_columns=[rrb.encodings.TextLogColumn(kind) for kind in (kinds.LogLevel, kinds.Body)],
    )


def _from_the_start() -> rrb.VisibleTimeRanges:
    """Each frame logs its piece of the trajectory only; all up to the cursor are shown together."""
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                timeline, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
            )
            for timeline in (entities.FRAME, entities.SENSOR_TIME)
        ]
    )
