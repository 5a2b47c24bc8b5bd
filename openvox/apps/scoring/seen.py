"""What a camera sees of a map: the instance at every pixel, by measured depth where there is some."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openvox.apps.scoring.truth_images import TruthImage
from openvox.core.types import DepthImage, InstanceMap
from openvox.core.voxels import RANGE, rows_of, voxel_key


class SeenMap:
    """The map, ready for pictures from many places."""

    def __init__(self, result: InstanceMap) -> None:
        self._map = result
        keys = voxel_key(result.voxel_index.astype(np.int64))
        order = np.argsort(keys)
        self._keys, self._labels = keys[order], result.voxel_instance[order]

    def labels(self, image: TruthImage) -> NDArray[np.int32]:
        """(height, width) instance at each pixel, 0 or less = none: that of the voxel which the picture's depth hits, a
        hole taking the depth beside it. Without depth voxels are drawn as cubes, which widens outlines by half a cube.
        """
        from openvox.view.render import render_map  # compiled code

        if image.depth is None:
            result = self._map
            return render_map(
                result.voxel_index, result.voxel_instance, result.voxel_size, image.world_from_camera, image.camera
            )
        if not len(self._keys) or not image.depth.any():
            return np.zeros(image.instances.shape, np.int32)
        points = _points(filled(image.depth), image)
        index = np.clip(np.floor(points / self._map.voxel_size), -RANGE, RANGE - 1).astype(np.int64)
        rows = rows_of(self._keys, voxel_key(index))
        return np.where(rows >= 0, self._labels[rows], 0).astype(np.int32).reshape(image.instances.shape)


def filled(depth: DepthImage) -> DepthImage:
    """Depth with every hole (0) filled by a nearest measurement; some pixel must have one."""
    import cv2

    holes = (depth == 0).astype(np.uint8)
    if not holes.any():
        return depth
    _, nearest = cv2.distanceTransformWithLabels(holes, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    measured = np.zeros(int(nearest.max()) + 1, depth.dtype)
    measured[nearest[depth > 0]] = depth[depth > 0]
    return np.asarray(measured[nearest], np.uint16)


def _points(depth: DepthImage, image: TruthImage) -> NDArray[np.float64]:
    """(pixels, 3) metres, world."""
    camera, pose = image.camera, image.world_from_camera
    z = depth / 1000.0
    x = (np.arange(camera.width) - camera.cx) / camera.fx * z
    y = ((np.arange(camera.height) - camera.cy) / camera.fy)[:, None] * z
    points: NDArray[np.float64] = np.stack([x, y, z], -1).reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
    return points
