"""The layout that travels in a Rerun recording: map, pictures, decisions, statistics; opens on the frame timeline."""

from __future__ import annotations

import rerun.blueprint as rrb

from openvox.view import entities


def blueprint() -> rrb.Blueprint:
    """3D map | detected above rendered masks | this frame's decisions above events and curves; panels collapsed."""
    pictures = rrb.Vertical(
        rrb.Spatial2DView(
            origin=entities.COLOR, contents=f"{entities.DETECTED}/**", name="Detected masks, coloured by instance"
        ),
        rrb.Spatial2DView(origin=entities.RENDERED, name="The map from the same pose"),
    )
    numbers = rrb.Vertical(
        rrb.TextDocumentView(origin=entities.DECISION_TABLE, name="Decisions of this frame"),
        rrb.Tabs(
            rrb.TextLogView(origin=entities.EVENTS, name="Events", columns=_when_and_what()),
            rrb.TimeSeriesView(origin=entities.INSTANCE_COUNT, name="Instances"),
            rrb.TimeSeriesView(origin=entities.VOXEL_COUNT, name="Voxels"),
        ),
        row_shares=[3, 2],
    )
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Tabs(_map(), _confidence()), pictures, numbers, column_shares=[5, 4, 7]),
        rrb.TimePanel(state="collapsed", timeline=entities.FRAME),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def _map() -> rrb.Spatial3DView:
    return _spatial("Map, coloured by instance", f"- {entities.CONFIDENCE}/**")


def _confidence() -> rrb.Spatial3DView:
    return _spatial("Map, coloured by confidence", f"- {entities.INSTANCES}/**")


def _spatial(name: str, without: str) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=entities.WORLD,
        contents=[f"+ {entities.WORLD}/**", without, f"+ {entities.DETECTED}/**"],
        name=name,
        overrides={entities.TRAJECTORY: _from_the_start()},
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
