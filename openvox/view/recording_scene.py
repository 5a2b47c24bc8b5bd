"""A recording as Rerun shows it: colour with masks, depth with its unit, and both where the camera stood."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from openvox.core.colors import instance_color
from openvox.core.types import Frame, Intrinsics, Mask
from openvox.view import entities
from openvox.view.labels import mask_image
from openvox.view.rrd_file import rrd_file
from openvox.view.viewpoint import world_from_color

APPLICATION = "openvox recording"
COLOR = f"{entities.CAMERA}/color"
MASKS = f"{entities.CAMERA}/masks"
DEPTH_CAMERA = "world/depth_camera"
DEPTH = f"{DEPTH_CAMERA}/depth"
PATH_COLOR = (255, 196, 0)
METRE = 1000.0
"""Units of depth in a metre, as Rerun wants it."""


def draw_recording(path: Path, frames: Iterable[tuple[Frame, Sequence[Mask] | None]]) -> None:
    """Write an .rrd of frames and the masks found in them (None: nobody looked). Raises OutputError."""
    with rrd_file(path, APPLICATION, recording_layout()) as stream:
        last: Frame | None = None
        for frame, masks in frames:
            stream.set_time(entities.FRAME, sequence=frame.index)
            stream.set_time(entities.SENSOR_TIME, timestamp=np.datetime64(frame.stamp_ns, "ns"))
            _log_cameras(stream, frame, last)
            if frame.color:
                picture = rr.EncodedImage(contents=frame.color, media_type=f"image/{frame.color_format}")
                stream.log(COLOR, picture)
            _log_masks(stream, masks or (), frame.rig.color)
            depth = cv2.imencode(".png", frame.depth, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
            stream.log(DEPTH, rr.EncodedDepthImage(blob=depth, media_type="image/png", meter=METRE))
            last = frame


def _log_cameras(stream: rr.RecordingStream, frame: Frame, last: Frame | None) -> None:
    """Both cameras, and this frame's piece of the path."""
    poses = {entities.CAMERA: world_from_color(frame), DEPTH_CAMERA: frame.world_from_depth.matrix()}
    for path, camera, size in ((entities.CAMERA, frame.rig.color, 0.5), (DEPTH_CAMERA, frame.rig.depth, 0.1)):
        if last is None or frame.rig != last.rig:
            stream.log(path, _pinhole(camera, size))
        stream.log(path, rr.Transform3D(translation=poses[path][:3, 3], mat3x3=poses[path][:3, :3]))
    here = poses[entities.CAMERA][:3, 3]
    piece = [here if last is None else world_from_color(last)[:3, 3], here]
    stream.log(entities.TRAJECTORY, rr.LineStrips3D([piece], colors=[PATH_COLOR], radii=[0.006]))


def _log_masks(stream: rr.RecordingStream, masks: Sequence[Mask], camera: Intrinsics) -> None:
    """Masks in colours by their number, smaller ones on top; what is no mask is left clear."""
    image = mask_image(masks, camera.height, camera.width) + 1
    infos = [
        rr.AnnotationInfo(number, f"mask {number - 1}: {mask.caption or mask.label}", instance_color(number))
        for number, mask in enumerate(masks, start=1)
    ]
    stream.log(
        MASKS,
        rr.SegmentationImage(image.astype(np.min_scalar_type(len(masks))), opacity=0.5),
        rr.AnnotationContext([rr.AnnotationInfo(0, "", (0, 0, 0, 0)), *infos]),
    )


def _pinhole(camera: Intrinsics, size: float) -> rr.Pinhole:
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + 0.5, camera.cy + 0.5),  # Rerun counts from the pixel's corner
        resolution=(camera.width, camera.height),
        image_plane_distance=size,
        color=PATH_COLOR,
    )


def recording_layout() -> rrb.Blueprint:
    """3D | colour with masks above depth."""
    always = rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(
                timeline, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
            )
            for timeline in (entities.FRAME, entities.SENSOR_TIME)
        ]
    )
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin=entities.CAMERA, name="Colour with masks"),
        rrb.Spatial2DView(origin=DEPTH_CAMERA, name="Depth (mm)"),
    )
    space = rrb.Spatial3DView(
        origin=entities.WORLD,
        contents=[f"+ {entities.WORLD}/**", f"- {MASKS}"],
        name="Where the camera stood",
        overrides={entities.TRAJECTORY: always},
    )
    return rrb.Blueprint(
        rrb.Horizontal(space, pictures, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=entities.FRAME),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
