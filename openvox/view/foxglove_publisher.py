"""The map for a robot's other tools: boxes, captions and changed voxels as Foxglove messages from a server."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import numpy as np

from openvox.core.colors import instance_color
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap, Step
from openvox.view.labels import Captions
from openvox.view.live_map import LiveMap, Rows

LOOPBACK = "127.0.0.1"
BOXES, VOXELS = "/openvox/instances", "/openvox/voxels"
WORLD = "world"
REPEAT = 30
"""Steps after which all boxes are sent again, for those who came late."""
POINT = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z")]
    + [("instance", "<u4")]
    + [(name, "u1") for name in ("red", "green", "blue", "alpha")]
)
LETTER_METRES = 0.08


class FoxglovePublisher:
    """An observer that sends each step's changes to whoever is connected; it listens while the block lasts.

    BOXES: foxglove.SceneUpdate, an entity an instance, named by its id. VOXELS: foxglove.PointCloud, the centres of the
    voxels whose votes changed, with their instance, 0 = background. port: of the loopback, 0 = any. voxel_size: metres.
    Raises InputError where the extra is not installed or the port cannot be had."""

    def __init__(self, port: int, *, voxel_size: float) -> None:
        try:
            import foxglove
            from foxglove import channels, messages
        except ImportError:
            raise InputError('to publish a map, install the extra "live": pip install "openvox[live]"') from None
        self._voxel_size, self._messages = voxel_size, messages
        self._map, self._captions = LiveMap(), Captions()
        self._shown: dict[int, Any] = {}  # the entity of every instance that has one
        self._steps = self._stamp = 0
        self._context = context = foxglove.Context()  # which channels do not keep alive
        self._boxes = channels.SceneUpdateChannel(BOXES, context=context)
        self._voxels = channels.PointCloudChannel(VOXELS, context=context)
        try:
            self._server = foxglove.start_server(name="openvox", host=LOOPBACK, port=port, context=context)
        except RuntimeError as error:
            raise InputError(f"port {port} of {LOOPBACK} cannot be had ({error}); choose another --publish") from None

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"ws://{LOOPBACK}:{self._server.port}"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.stop()

    def on_step(self, step: Step) -> None:
        """Send what changed."""
        change = self._map.apply(step)
        self._captions.add(step)
        self._steps += 1
        self._stamp = stamp = step.frame.stamp_ns
        changed = {*change.moved, *change.regrouped} - {0}
        gone = [instance for instance in sorted(changed & self._shown.keys()) if not self._map.count(instance)]
        for instance in gone:
            del self._shown[instance]
        for instance in sorted(changed):
            if self._map.count(instance):
                self._shown[instance] = self._entity(instance, stamp)
        sent = sorted(self._shown) if self._steps % REPEAT == 0 else sorted(changed & self._shown.keys())
        if sent or gone:
            self._boxes.log(self._update([self._shown[instance] for instance in sent], gone, stamp), log_time=stamp)
        if len(step.changes.touched):
            cloud = self._cloud(step.changes.touched.astype(np.int64), stamp)
            self._voxels.log(cloud, log_time=stamp)

    def close(self, result: InstanceMap) -> None:
        """What finishing dropped, goes."""
        kept = set(result.instance_id.tolist())
        gone = sorted(self._shown.keys() - kept)
        left = [self._shown[instance] for instance in sorted(kept & self._shown.keys())]
        self._boxes.log(self._update(left, gone, self._stamp), log_time=self._stamp)

    def _update(self, entities: list[Any], gone: list[int], stamp: int) -> Any:
        m = self._messages
        kind = m.SceneEntityDeletionType.MatchingId
        deletions = [m.SceneEntityDeletion(timestamp=self._time(stamp), type=kind, id=str(one)) for one in gone]
        return m.SceneUpdate(entities=entities, deletions=deletions)

    def _entity(self, instance: int, stamp: int) -> Any:
        """A box around the instance's voxels, with its caption above."""
        m, index = self._messages, self._map.index_of(self._map.rows(instance))
        low, high = index.min(0) * self._voxel_size, (index.max(0) + 1) * self._voxel_size
        x, y, z = ((low + high) / 2).tolist()
        red, green, blue = (part / 255 for part in instance_color(instance))
        size = m.Vector3(**dict(zip("xyz", (high - low).tolist(), strict=True)))
        box = m.CubePrimitive(pose=self._pose(x, y, z), size=size, color=m.Color(r=red, g=green, b=blue, a=0.25))
        text = m.TextPrimitive(
            pose=self._pose(x, y, float(high[2]) + LETTER_METRES),
            billboard=True,
            font_size=LETTER_METRES,
            color=m.Color(r=red, g=green, b=blue, a=1.0),
            text=f"{instance}: {self._captions.of(instance)}",
        )
        return m.SceneEntity(timestamp=self._time(stamp), frame_id=WORLD, id=str(instance), cubes=[box], texts=[text])

    def _pose(self, x: float, y: float, z: float) -> Any:
        m = self._messages
        return m.Pose(position=m.Vector3(x=x, y=y, z=z), orientation=m.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))

    def _cloud(self, rows: Rows, stamp: int) -> Any:
        """The voxels of these numbers."""
        m, instances = self._messages, self._map.instances_of(rows)
        points = np.zeros(len(rows), POINT)
        for axis, values in zip("xyz", self._map.index_of(rows).T, strict=True):
            points[axis] = (values + 0.5) * self._voxel_size
        points["instance"], points["alpha"] = instances, 255
        for instance in np.unique(instances).tolist():
            mine = instances == instance
            points["red"][mine], points["green"][mine], points["blue"][mine] = instance_color(instance)
        numbers = m.PackedElementFieldNumericType
        kinds = [numbers.Float32] * 3 + [numbers.Uint32] + [numbers.Uint8] * 4
        offsets = [0, 4, 8, 12, 16, 17, 18, 19]
        fields = [
            m.PackedElementField(name=name, offset=offset, type=kind)
            for name, offset, kind in zip(POINT.names or (), offsets, kinds, strict=True)
        ]
        return m.PointCloud(
            timestamp=self._time(stamp),
            frame_id=WORLD,
            pose=self._pose(0.0, 0.0, 0.0),
            point_stride=POINT.itemsize,
            fields=fields,
            data=points.tobytes(),
        )

    def _time(self, stamp: int) -> Any:
        return self._messages.Timestamp(*divmod(stamp, 10**9))
