"""glb: each instance as a solid of its own, its inner faces left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.apps.described import described
from openvox.core.colors import instance_color
from openvox.core.types import InstanceMap
from openvox.formats.glb import Solid
from openvox.view.faces import open_faces

ABOUT = ("instance", "caption", "state", "observations", "confidence", "voxels", "first_frame", "last_frame")


def solids(result: InstanceMap) -> list[Solid]:
    """One an instance that has voxels, by id, named by its caption; a face between two voxels of it is left out."""
    faces = open_faces(result.voxel_index, result.voxel_instance)
    order = np.argsort(result.voxel_instance, kind="stable")
    found = []
    for one in described(result):
        number = one["instance"]
        first, last = np.searchsorted(result.voxel_instance, [number, number + 1], sorter=order)
        mine = order[first:last]
        if not len(mine):
            continue
        low = result.voxel_index[mine].min(0)
        vertices, triangles = _surface(result.voxel_index[mine] - low, faces[mine])
        found.append(
            Solid(
                name=" ".join(one["caption"].split()) or f"instance {number}",
                color=instance_color(number),
                origin=tuple((low * result.voxel_size).tolist()),
                vertices=(vertices * result.voxel_size).astype(np.float32),
                triangles=triangles,
                about={name: one[name] for name in ABOUT},
            )
        )
    return found


def _surface(cells: NDArray[np.int32], faces: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
    """Corners (n, 3) of the open faces, each once, and two triangles a face, (m, 3). cells: from 0."""
    squares = []
    for face in range(6):
        here = cells[(faces >> face & 1) > 0].astype(np.int64)
        squares.append(here[:, None] + _corners(face // 2, face % 2))
    corners = np.concatenate(squares).reshape(-1, 3)
    vertices, place = np.unique(corners, axis=0, return_inverse=True)
    square = place.reshape(-1, 4)
    return vertices, np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]]).astype(np.uint32)


def _corners(axis: int, upper: int) -> NDArray[np.int64]:
    """(4, 3) of a face of the unit cube, counter-clockwise seen from outside."""
    corners = np.zeros((4, 3), np.int64)
    corners[:, axis] = upper
    corners[:, (axis + 1) % 3] = [0, 1, 1, 0]
    corners[:, (axis + 2) % 3] = [0, 0, 1, 1]
    return corners if upper else corners[::-1]
