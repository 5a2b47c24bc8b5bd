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
CAPTIONS = "world/captions"
CONFIDENCE = "world/confidence"
CATEGORIES = "world/categories"
ANSWERS = "world/answers"
ENTROPY = "world/entropy"
TOUCHED = "world/touched"
REGIONS = "world/masks"

DETECTED = "camera/detected"
COLOR = "camera/detected/color"
MASKS = "camera/detected/masks"
MASK_NAMES = "camera/names"
DEPTH = "camera/depth"
RENDERED = "camera/rendered"
RENDERED_CONFIDENCE = "camera/rendered_confidence"

DECISION_TABLE = "decisions/table"
DECISION_DATA = "decisions/data"
CANDIDATES = "decisions/candidates"
GRAPH = "decisions/graph"
EVENTS = "events"
LIVES = "lives"
INSTANCE_TABLE = "instances/table"
BEST_VIEWS = "instances/views"
BEST_VIEW_NAMES = "instances/views/names"
STATS = "stats"
INSTANCE_COUNT = "stats/instances"
VOXEL_COUNT = "stats/voxels"
MARGINS = "stats/margins"
MILLISECONDS = "stats/milliseconds"


def instance_path(instance: int) -> str:
    """Voxels of one instance in its colour."""
    return f"{INSTANCES}/{instance:04d}"


def confidence_path(instance: int) -> str:
    """Voxels of one instance coloured by confidence."""
    return f"{CONFIDENCE}/{instance:04d}"


def entropy_path(instance: int) -> str:
    """Voxels of one instance coloured by the entropy of their votes."""
    return f"{ENTROPY}/{instance:04d}"


def region_path(mask: int) -> str:
    """Voxels under one mask of the frame."""
    return f"{REGIONS}/{mask:02d}"


CAMERA_FRAME = f"tf#/{CAMERA}"
"""Rerun's name for the coordinate frame of the camera entity: pictures put into it appear on the frustum in 3D."""


def category_path(instance: int) -> str:
    """Voxels of one instance in the colour of its category."""
    return f"{CATEGORIES}/{instance:04d}"


def answer_path(number: int, what: str) -> str:
    """Voxels of an answer to a question, or of the rest. number: of the question, from 0."""
    return f"{ANSWERS}/{number:02d}/{what}"
