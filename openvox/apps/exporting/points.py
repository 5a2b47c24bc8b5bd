"""ply: the voxels of instances as coloured points."""

from __future__ import annotations

import numpy as np

from openvox.apps.described import voxel_centers
from openvox.core.colors import instance_color
from openvox.core.types import InstanceMap
from openvox.formats.ply import ply

VERTEX = np.dtype(
    [
        *((axis, "<f4") for axis in "xyz"),
        *((color, "u1") for color in ("red", "green", "blue")),
        ("instance", "<i4"),
        ("confidence", "<f4"),
    ]
)


def points(result: InstanceMap) -> bytes:
    """Binary little-endian PLY of the centres of all voxels that belong to an instance, in the map's order."""
    mine = result.voxel_instance > 0
    vertices = np.zeros(int(mine.sum()), VERTEX)
    for axis, values in zip("xyz", voxel_centers(result)[mine].T, strict=True):
        vertices[axis] = values
    ids, place = np.unique(result.voxel_instance[mine], return_inverse=True)
    colors = np.array([instance_color(int(i)) for i in ids], np.uint8).reshape(-1, 3)[place]
    for name, values in zip(("red", "green", "blue"), colors.T, strict=True):
        vertices[name] = values
    vertices["instance"], vertices["confidence"] = result.voxel_instance[mine], result.voxel_confidence[mine]
    return ply(vertices, None, f"openvox map, voxels of {result.voxel_size:g} m")
