"""Parameters of the perception stages that are computed here."""

from __future__ import annotations

from dataclasses import dataclass, field

from openvox.core.parameters import parameter


@dataclass(frozen=True, kw_only=True)
class GeometryParameters:
    """Regions from depth alone. Pixels are those of a working picture of about 320 columns, whatever the camera has."""

    near: float = parameter(0.15, "m", 0.0, 10.0, why="nearer depth is ignored: sensors measure nothing sound there")
    far: float = parameter(6.0, "m", 0.1, 65.0, why="farther depth is ignored: noise grows with its square")
    planes: bool = parameter(True, "", why="floor, walls and ceiling are background; off, they come out as regions")
    plane_frames: int = parameter(
        24, "frames", 1, 1000, needs="geometry.planes", why="spread over the recording, to find the room's planes in"
    )
    plane_area: float = parameter(
        0.8, "m2", 0.01, 1000.0, needs="geometry.planes", why="a smaller plane bounds no room"
    )
    tolerance: float = parameter(
        0.012, "m", 0.0, 1.0, why="a point so far off a neighbour's surface is behind a step, at depth 0"
    )
    tolerance_growth: float = parameter(
        0.006, "m/m2", 0.0, 1.0, why="growth of the tolerance with the square of depth, as the sensor's noise"
    )
    crease: float = parameter(
        0.97, "cosine", -1.0, 1.0, why="of two normals: below it a concave bend parts two things (14 degrees)"
    )
    piece_pixels: int = parameter(60, "px", 1, 100_000, why="smaller pieces between cuts are noise, or left-overs")
    merge_smooth: float = parameter(
        0.6, "share", 0.0, 1.0, why="two pieces are one if more of their border than this is smooth or convex"
    )
    merge_concave: float = parameter(
        0.25, "share", 0.0, 1.0, why="two pieces stay two if this much of their border is a concave crease"
    )
    residue: bool = parameter(
        True, "", why="plants and thin legs are too torn for pieces: what is left over is parted by depth alone"
    )
    residue_pixels: int = parameter(
        600, "px", 1, 100_000, needs="geometry.residue", why="smaller left-overs are mostly noise"
    )
    min_pixels: int = parameter(100, "px", 1, 100_000, why="smaller regions are mostly noise")


@dataclass(frozen=True, kw_only=True)
class OfflineParameters:
    """Boxes, parts and words of the front end that comes with openvox; its regions are those of `geometry`, and its
    pixels too."""

    box_score: float = parameter(0.3, "score", 0.0, 1.0, why="less sure boxes are more often wrong than right")
    claim_inside: float = parameter(0.75, "share", 0.0, 1.0, why="of a region that must lie in a box that takes it")
    claim_fill: float = parameter(
        0.15, "share", 0.0, 1.0, why="of a box that its regions fill, else it is cut out by colour"
    )
    cut_fill: float = parameter(0.25, "share", 0.0, 1.0, why="of a box that is cut out by colour, else it is dropped")
    support_height: float = parameter(0.03, "m", 0.0, 1.0, why="what rises so far above a top stands on it")
    support_rim: float = parameter(0.012, "m", 0.0, 1.0, why="from so far above the top on it is part of what rises")
    support_within: float = parameter(
        0.8, "share", 0.0, 1.0, why="of what stands on a top that lies within its outline; arms of a seat do not"
    )
    support_pixels: int = parameter(
        100, "px", 1, 100_000, why="smaller things on a support are too far to contradict others: they count as regions"
    )
    min_pixels: int = parameter(50, "px", 1, 100_000, why="smaller things on a top, or patches, are mostly noise")
    small_pixels: int = parameter(250, "px", 0, 1_000_000, why="smaller nameless regions are often pieces: less sure")
    edge_pixels: int = parameter(
        1000, "px", 0, 1_000_000, why="smaller nameless regions that the picture's edge cuts are mostly pieces"
    )
    stem_pixels: int = parameter(
        40,
        "px",
        1,
        100_000,
        needs="geometry.residue",
        why="smaller left-overs are noise; from here on they may be legs",
    )
    patch_ground: int = parameter(2500, "px", 1, 1_000_000, why="smaller surfaces hold no patches")
    word_sure: float = parameter(0.5, "score", 0.0, 1.0, why="from here on a detector's word is taken")
    word_likely: float = parameter(0.4, "score", 0.0, 1.0, why="or from here on, if the classifier has none")
    word_classified: float = parameter(0.35, "probability", 0.0, 1.0, why="below it the classifier guesses")


@dataclass(frozen=True, kw_only=True)
class OracleParameters:
    """Masks from the recording's ground truth."""

    min_pixels: int = parameter(60, "px", 1, 1_000_000, why="less of an object is too little to be seen")
    miss: float = parameter(0.0, "share", 0.0, 1.0, why="of the objects in view are not seen in an episode")
    split: float = parameter(0.0, "share", 0.0, 1.0, why="of them are seen as two in an episode")
    merge: float = parameter(0.0, "share", 0.0, 1.0, why="of touching pairs are seen as one in an episode")
    boundary: float = parameter(
        0.0, "px", 0.0, 50.0, why="masks are up to so much too large or too small in an episode"
    )
    episode: int = parameter(6, "frames", 1, 100_000, why="a fault lasts so long, as those of real detectors do")
    seed: int = parameter(0, "number", 0, 1_000_000_000, why="another one gives other faults")


@dataclass(frozen=True, kw_only=True)
class PerceptionParameters:
    """All groups; a front end uses that of its own name, `offline` also `geometry`."""

    geometry: GeometryParameters = field(default_factory=GeometryParameters)
    offline: OfflineParameters = field(default_factory=OfflineParameters)
    oracle: OracleParameters = field(default_factory=OracleParameters)
