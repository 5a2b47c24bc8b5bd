"""Every entity path and timeline that a Rerun recording of ours has; the blueprint and the observer agree here."""

from __future__ import annotations

APPLICATION = "openvox"
"""Blueprints belong to it: the viewer keeps one layout for all recordings of one application."""

FRAME = "frame"
SENSOR_TIME = "sensor_time"

WORLD = "world"
CAMERA = "world/camera"
TRAJECTORY = "world/trajectory"
INSTANCES = "world/instances"
CONFIDENCE = "world/confidence"
VOXEL_STATES = "world/voxel_states"

DETECTED = "camera/detected"
COLOR = "camera/detected/color"
MASKS = "camera/detected/masks"
RENDERED = "camera/rendered"

DECISION_TABLE = "decisions/table"
DECISION_DATA = "decisions/data"
EVENTS = "events"
INSTANCE_COUNT = "stats/instances"
VOXEL_COUNT = "stats/voxels"


def instance_path(instance: int) -> str:
    """Voxels of one instance in its colour."""
    return f"{INSTANCES}/{instance:04d}"


def confidence_path(instance: int) -> str:
    """Voxels of one instance coloured by confidence."""
    return f"{CONFIDENCE}/{instance:04d}"


CAMERA_FRAME = f"tf#/{CAMERA}"
"""Rerun's name for the coordinate frame of the camera entity: pictures put into it appear on the frustum in 3D."""
