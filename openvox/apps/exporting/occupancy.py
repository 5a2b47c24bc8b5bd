"""A grid for navigation as ROS map_server reads it: a picture and a few lines of YAML that place it.

Cells are as wide as voxels. Occupied: something stands there between the lowest and the highest height that a robot
meets. Free: the floor was seen, and nothing stands there. Unknown: neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.core.export_parameters import OccupancyParameters
from openvox.core.types import InstanceMap

OCCUPIED, UNKNOWN, FREE = 0, 205, 254
"""Grey values, as map_saver writes them."""
OCCUPIED_ABOVE, FREE_BELOW = 0.65, 0.196
"""Of (255 - grey) / 255; unknown, 0.19608, lies between, which 0.25 (a common default) would read as free."""
MAX_CELLS = 1 << 28


@dataclass(frozen=True, eq=False)
class Grid:
    """What map_server reads."""

    grey: NDArray[np.uint8]
    """(rows, columns), the first row at the highest y, the first column at the lowest x."""
    resolution: float
    """Metres a cell."""
    origin: tuple[float, float]
    """x and y of the lower left corner, metres."""
    floor: float
    """z of the floor, metres."""

    def pgm(self) -> bytes:
        """The picture, binary PGM."""
        height, width = self.grey.shape
        return f"P5\n{width} {height}\n255\n".encode() + self.grey.tobytes()

    def yaml(self, image: str) -> str:
        """The lines beside it; image: the picture's name in the same folder."""
        x, y = self.origin
        return (
            f"image: {_quoted(image)}\nmode: trinary\nresolution: {self.resolution!r}\norigin: [{x!r}, {y!r}, 0.0]\n"
            f"negate: 0\noccupied_thresh: {OCCUPIED_ABOVE}\nfree_thresh: {FREE_BELOW}\n"
        )


def occupancy(result: InstanceMap, parameters: OccupancyParameters) -> Grid:
    """The grid of a map whose z is up. Raises InputError: the map is empty, too wide, or a height makes no sense."""
    if parameters.obstacle_low >= parameters.obstacle_high:
        raise InputError(
            f"occupancy.obstacle_low is {parameters.obstacle_low:g} m, occupancy.obstacle_high "
            f"{parameters.obstacle_high:g} m; expected the first below the second"
        )
    if not len(result.voxel_index):
        raise InputError("the map has no voxels, so there is no floor to drive on; replay the recording first")
    low, high = result.voxel_index[:, :2].min(0), result.voxel_index[:, :2].max(0)
    columns, rows = (high.astype(np.int64) - low + 1).tolist()
    if columns * rows > MAX_CELLS:
        raise InputError(f"the map is {columns} x {rows} voxels wide; a grid has up to {MAX_CELLS} cells")
    floor = _floor(result, parameters)
    height = np.round(
        (result.voxel_index[:, 2] + 0.5) * result.voxel_size - floor, 6
    )  # so that 0.1 is no more than 0.1
    deep = -parameters.drop_depth if parameters.drops else -np.inf
    grey = np.full((rows, columns), UNKNOWN, np.uint8)
    for value, here in (
        (OCCUPIED, height < deep),
        (FREE, (height >= deep) & (height <= parameters.obstacle_low)),
        (OCCUPIED, (height > parameters.obstacle_low) & (height < parameters.obstacle_high)),
    ):
        x, y = (result.voxel_index[here, :2] - low).T
        grey[rows - 1 - y, x] = value
    corner = (low * result.voxel_size).tolist()
    return Grid(grey, result.voxel_size, (corner[0], corner[1]), floor)


def _floor(result: InstanceMap, parameters: OccupancyParameters) -> float:
    """z of the floor's middle, metres."""
    from openvox.view.pictures import floor_and_ceiling

    if not parameters.find_floor:
        return parameters.floor_height
    return (floor_and_ceiling(result.voxel_index[:, 2])[0] + 0.5) * result.voxel_size


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"
