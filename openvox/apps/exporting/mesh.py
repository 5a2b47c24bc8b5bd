"""A surface from the recording, by Open3D's TSDF, whose vertices say what the map says of the place where they lie."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.apps.exporting.points import VERTEX
from openvox.apps.scoring.labels import rows_at_points
from openvox.core.colors import instance_color
from openvox.core.errors import InputError
from openvox.core.export_parameters import MeshParameters
from openvox.core.types import Frame, InstanceMap
from openvox.formats.recording import read_frames, recording_info

Progress = Callable[[int, int], None] | None
Points = NDArray[np.float64]
Triangles = NDArray[np.int32]


def surface(recording: Path, parameters: MeshParameters, progress: Progress = None) -> tuple[Points, Triangles]:
    """Vertices (n, 3), metres, world, and triangles (m, 3) of what the depth of all frames agrees on.

    Raises InputError: the extra is absent, or no frame measured anything."""
    o3d = _open3d()
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight"),
        attr_dtypes=(o3d.core.float32, o3d.core.float32),
        attr_channels=((1), (1)),
        voxel_size=parameters.voxel_length,
        block_resolution=8,
        block_count=10_000,  # to begin with; it grows
    )
    total = recording_info(recording).frames
    with closing(read_frames(recording, truth=False)) as frames:
        for done, frame in enumerate(frames, 1):
            _integrate(o3d, grid, frame, parameters)
            if progress is not None:
                progress(done, total)
    vertices, triangles = _triangles(grid, parameters.min_frames)
    if not len(triangles):
        raise InputError(
            f"{recording}: its depth makes no surface; raise mesh.max_depth, lower mesh.min_frames, or look with "
            "openvox view whether it measured anything"
        )
    return vertices, triangles


def labelled(vertices: Points, result: InstanceMap) -> NDArray[np.void]:
    """The vertices for a file: instance, its colour, and confidence of the nearest voxel within 1.5 edges.

    Instance 0, grey, is what belongs to none; confidence 0 where there is no voxel."""
    rows = rows_at_points(vertices, result)
    instance = np.append(result.voxel_instance, 0)[rows]  # row -1 is the one appended
    out = np.zeros(len(vertices), VERTEX)
    for axis, values in zip("xyz", vertices.T, strict=True):
        out[axis] = values
    ids, place = np.unique(instance, return_inverse=True)
    colors = np.array([instance_color(i) for i in ids.tolist()], np.uint8).reshape(-1, 3)[place]
    for name, values in zip(("red", "green", "blue"), colors.T, strict=True):
        out[name] = values
    out["instance"], out["confidence"] = instance, np.append(result.voxel_confidence, 0)[rows]
    return out


def _open3d() -> Any:
    try:
        import open3d
    except ImportError:
        raise InputError(
            '--mesh needs an extra that is not installed: pip install "openvox[mesh]" (Open3D, 0.9 GB on disk)'
        ) from None
    return open3d


def _integrate(o3d: Any, grid: Any, frame: Frame, parameters: MeshParameters) -> None:
    """A frame's depth into the grid; one that measured nothing within reach adds nothing."""
    if not ((frame.depth > 0) & (frame.depth < 1000 * parameters.max_depth)).any():
        return  # Open3D refuses it
    rig = frame.rig.depth
    pinhole = o3d.core.Tensor(np.array([[rig.fx, 0, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]], np.float64))
    camera_from_world = o3d.core.Tensor(np.linalg.inv(frame.world_from_depth.matrix()))
    depth = o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(frame.depth)))
    reach = (1000.0, parameters.max_depth, parameters.truncation / parameters.voxel_length)
    blocks = grid.compute_unique_block_coordinates(depth, pinhole, camera_from_world, *reach)
    grid.integrate(blocks, depth, pinhole, camera_from_world, *reach)


def _triangles(grid: Any, min_frames: int) -> tuple[Points, Triangles]:
    mesh = grid.extract_triangle_mesh(weight_threshold=min_frames - 0.5).to_legacy()
    return np.asarray(mesh.vertices, np.float64).reshape(-1, 3), np.asarray(mesh.triangles, np.int32).reshape(-1, 3)
