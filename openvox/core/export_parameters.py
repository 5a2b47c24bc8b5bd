"""Parameters of what `openvox export` makes out of a map."""

from __future__ import annotations

from dataclasses import dataclass, field

from openvox.core.parameters import parameter


@dataclass(frozen=True, kw_only=True)
class OccupancyParameters:
    """A grid for navigation. Heights are above the floor, in metres."""

    find_floor: bool = parameter(
        True, "", why="the floor is the fullest layer in the lower half of the map; off, it is at floor_height"
    )
    floor_height: float = parameter(
        0.0, "m", -10_000.0, 10_000.0, without="occupancy.find_floor", why="z of the floor where it is known better"
    )
    obstacle_low: float = parameter(
        0.1, "m", 0.0, 5.0, why="what ends lower is driven over: carpets, door sills, and the noise of the floor itself"
    )
    obstacle_high: float = parameter(
        1.5, "m", 0.01, 100.0, why="what begins higher is driven under: about the height of a service robot"
    )
    drops: bool = parameter(True, "", why="where all lies below the floor is a stair or a pit, as bad as a wall")
    drop_depth: float = parameter(
        0.1, "m", 0.0, 100.0, needs="occupancy.drops", why="so far below the floor it is a drop; less is noise"
    )


@dataclass(frozen=True, kw_only=True)
class RenderedParameters:
    """Masks of the map as the cameras of a recording see it."""

    min_pixels: int = parameter(
        60, "px", 1, 1_000_000, why="a smaller mask is mostly the rim of a voxel; as masks.min_pixels of replay"
    )


@dataclass(frozen=True, kw_only=True)
class MeshParameters:
    """A surface out of all depth pictures."""

    voxel_length: float = parameter(
        0.02, "m", 0.002, 1.0, why="edge of the grid in which depth is averaged; half a voxel of the map"
    )
    truncation: float = parameter(
        0.08, "m", 0.004, 4.0, why="so far behind a surface depth says nothing; beyond the noise of sensors"
    )
    max_depth: float = parameter(6.0, "m", 0.1, 65.0, why="depth beyond it is ignored, as map.max_depth of replay")
    min_frames: int = parameter(3, "frames", 1, 10_000, why="what fewer frames saw is mostly noise at depth steps")


@dataclass(frozen=True, kw_only=True)
class ExportParameters:
    """All of them."""

    occupancy: OccupancyParameters = field(default_factory=OccupancyParameters)
    rendered: RenderedParameters = field(default_factory=RenderedParameters)
    mesh: MeshParameters = field(default_factory=MeshParameters)
