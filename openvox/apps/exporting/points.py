"""ply: the voxels of instances as coloured points."""

from __future__ import annotations

import numpy as np

from openvox.apps.described import voxel_centers
from openvox.core.colors import instance_color
from openvox.core.types import InstanceMap

VERTEX = np.dtype(
    [
        *((axis, "<f4") for axis in "xyz"),
        *((color, "u1") for color in ("red", "green", "blue")),
        ("instance", "<i4"),
        ("confidence", "<f4"),
    ]
)
_PLY_NAMES = {"f4": "float", "u1": "uchar", "i4": "int"}


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
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment openvox map, voxels of {result.voxel_size:g} m",
        f"element vertex {len(vertices)}",
        *(f"property {_PLY_NAMES[VERTEX[name].str[1:]]} {name}" for name in VERTEX.names or ()),
        "end_header",
    ]
    return "".join(f"{line}\n" for line in header).encode("ascii") + vertices.tobytes()
