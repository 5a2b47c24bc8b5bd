"""Every step of the mapper as a Rerun recording: what the camera saw, what was decided, what the map became.

The observer keeps its own copy of the voxel states (`LiveMap`) and logs only what changed. Drawings of instances may be
a few voxels behind (`Redraw` says how many); `world/voxel_states` is exact in every frame, and so is the whole at the
end.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from openvox.core.colors import instance_color
from openvox.core.errors import OutputError
from openvox.core.types import Event, Frame, InstanceMap, Intrinsics, Step
from openvox.formats.atomic import partial_file
from openvox.view import decision_table, entities
from openvox.view.blueprint import blueprint, overview
from openvox.view.labels import Captions, Label, detected_labels, instance_labels, mask_image, present
from openvox.view.live_map import Change, LiveMap
from openvox.view.redraw import Redraw
from openvox.view.render import render_map
from openvox.view.viewpoint import world_from_color

CONFIDENCE_EVERY = 30
"""Steps between two drawings of the confidences, which cost as much as the map itself."""
END_OF_FILE = b"RRF2FOOT"
"""Near the end of every recording that was closed."""
PATH_COLOR = (255, 196, 0)


class RerunObserver:
    """Writes `path` (.rrd) while steps come; the file appears when `close` is called, and not at all after `abort`.

    voxel_size: metres. images: log colour, detected and rendered masks (most of the file's size). camera: False where
    steps come without true poses, so that neither frustum nor path is drawn. Use it as a context manager: leaving it
    before `close` aborts. Raises OutputError where the file cannot be written.
    """

    def __init__(self, path: Path, *, voxel_size: float, images: bool = True, camera: bool = True) -> None:
        self._voxel_size = voxel_size
        self._images = images
        self._camera = camera
        self._map, self._captions, self._redraw = LiveMap(), Captions(), Redraw()
        self._steps = 0
        self._unsure: set[int] = set()  # instances whose confidences changed since they were drawn
        self._seen: set[int] = set()  # instances that were drawn at some time
        self._shown: set[str] = set()  # entities of instances that show something now
        self._frame: Frame | None = None
        self._recording = rr.RecordingStream(entities.APPLICATION, send_properties=False)
        self._open(path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.abort()

    def on_step(self, step: Step) -> None:
        """Log one frame; nothing of the step is changed. Raises OutputError where the file cannot be written."""
        with self._refusals():
            self._log_step(step)

    def _log_step(self, step: Step) -> None:
        self._at(step.frame)
        self._log_camera(step.frame)
        change = self._map.apply(step)
        self._captions.add(step)
        self._steps += 1
        if self._images:
            self._log_detected(step)
            self._log_rendered(step.frame, self._map.index, self._map.instances())
        self._log_decisions(step)
        self._log_voxel_states(change)
        self._log_instances(change)
        self._log_confidences(change)
        self._log(entities.INSTANCE_COUNT, rr.Scalars(len(self._map.populated())))
        self._log(entities.VOXEL_COUNT, rr.Scalars(step.voxels))

    def close(self, result: InstanceMap) -> None:
        """Log the finished map at the last frame and complete the file. Raises OutputError."""
        with self._file, self._refusals():
            if self._frame is not None:
                self._log_finished(result, self._frame)
                self._log_events(result.events)
                self._recording.send_blueprint(blueprint(overview(result)), make_active=False)
            self._recording.flush()
            self._recording.disconnect()
            _check_whole(self._partial)

    def abort(self) -> None:
        """Give up: nothing is left behind. After `close` nothing happens."""
        with suppress(RuntimeError):  # of a writer that has stopped already
            self._recording.disconnect()
        with suppress(_AbortedError), self._file:
            raise _AbortedError

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """What Rerun makes of a full disk, as a sentence of ours."""
        try:
            yield
        except RuntimeError as error:
            raise OutputError(
                f"{self._path} could not be written (Rerun's writer stopped: {error}); nothing was left there: "
                "check the space on the disk"
            ) from error

    def _open(self, path: Path) -> None:
        self._path = path
        with ExitStack() as stack:
            self._partial = stack.enter_context(partial_file(path))
            try:
                self._recording.save(self._partial, default_blueprint=blueprint())
            except RuntimeError as error:  # what Rerun makes of the system's refusal
                raise OSError(str(error)) from error
            self._file = stack.pop_all()
        self._recording.set_log_time_enabled(False)
        self._recording.set_log_tick_enabled(False)
        self._recording.send_recording_name(path.stem)
        for picture in (entities.COLOR, entities.MASKS):
            self._log(picture, rr.CoordinateFrame(entities.CAMERA_FRAME), static=True)
        self._log(entities.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log(entities.INSTANCE_COUNT, rr.SeriesLines(names=["instances"]), static=True)
        self._log(entities.VOXEL_COUNT, rr.SeriesLines(names=["voxels"]), static=True)

    def _log(self, path: str, *what: Any, static: bool = False) -> None:
        self._recording.log(path, *what, static=static)

    def _at(self, frame: Frame) -> None:
        self._recording.set_time(entities.FRAME, sequence=frame.index)
        self._recording.set_time(entities.SENSOR_TIME, timestamp=np.datetime64(frame.stamp_ns, "ns"))

    def _log_camera(self, frame: Frame) -> None:
        """The frustum, and this frame's piece of the trajectory."""
        last, self._frame = self._frame, frame
        if not self._camera:
            return
        camera, pose = frame.rig.color, world_from_color(frame)
        if last is None or last.rig.color != camera:
            self._log(entities.CAMERA, _pinhole(camera))
        self._log(entities.CAMERA, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        piece = [pose[:3, 3] if last is None else world_from_color(last)[:3, 3], pose[:3, 3]]
        self._log(entities.TRAJECTORY, rr.LineStrips3D([piece], colors=[PATH_COLOR], radii=[0.006]))

    def _log_detected(self, step: Step) -> None:
        """The source's picture as it is, and the masks over it."""
        camera = step.frame.rig.color
        if step.frame.color:
            media_type = f"image/{step.frame.color_format}"
            self._log(entities.COLOR, rr.EncodedImage(contents=step.frame.color, media_type=media_type))
        image = mask_image(step.masks, camera.height, camera.width)
        names = detected_labels(step.masks, {decision.mask: decision.instance for decision in step.decisions})
        self._log_labels(entities.MASKS, image, names)

    def _log_rendered(self, frame: Frame, index: NDArray[np.int32], instances: NDArray[np.int32]) -> None:
        """The map as the colour camera sees it."""
        image = render_map(index, instances, self._voxel_size, world_from_color(frame), frame.rig.color)
        names = instance_labels(present(image), self._captions.of)
        self._log_labels(entities.RENDERED, image, names)

    def _log_labels(self, path: str, image: NDArray[np.int32], labels: Mapping[int, Label]) -> None:
        """A label image with names and colours for its values; what has no label is left clear."""
        classes = np.zeros(max(int(image.max(initial=0)), *labels, 0) + 2, np.uint16)
        classes[[value + 1 for value in labels]] = range(1, len(labels) + 1)
        infos = [
            rr.AnnotationInfo(number, label.text, label.color) for number, label in enumerate(labels.values(), start=1)
        ]
        picture = rr.SegmentationImage(classes[image + 1].astype(np.min_scalar_type(len(labels))))
        self._log(path, picture, rr.AnnotationContext([rr.AnnotationInfo(0, "", (0, 0, 0, 0)), *infos]))

    def _log_decisions(self, step: Step) -> None:
        table = rr.TextDocument(decision_table.markdown(step), media_type=rr.MediaType.MARKDOWN)
        self._log(entities.DECISION_TABLE, table)
        self._log(entities.DECISION_DATA, _values(**decision_table.columns(step)))
        self._log_events(step.events)

    def _log_events(self, events: Iterable[Event]) -> None:
        for event in events:
            level = rr.TextLogLevel.INFO if event.kind in ("new", "confirmed") else rr.TextLogLevel.WARN
            others = f" with {', '.join(map(str, event.others))}" if event.others else ""
            caption = f" ({self._captions.of(event.instance)})".replace(" ()", "")
            text = f"{event.kind} {event.instance}{caption}{others}: {event.text}"
            self._log(entities.EVENTS, rr.TextLog(text, level=level))

    def _log_voxel_states(self, change: Change) -> None:
        """Number, instance and its share of the votes of each voxel that changed; the index of each new one."""
        rows, new = change.rows, self._map.index[change.first_new :]
        self._log(
            entities.VOXEL_STATES,
            _values(
                voxel=rows.astype(np.int32),
                instance=self._map.instances_of(rows),
                percent=self._map.percent[rows],
                **{f"new_{axis}": new[:, column] for column, axis in enumerate("xyz")},
            ),
        )

    def _log_instances(self, change: Change) -> None:
        for instance in self._redraw.due(change, self._map):
            rows = self._map.rows(instance)
            self._draw_instance(instance, self._map.index[rows], self._captions.of(instance))

    def _log_confidences(self, change: Change) -> None:
        self._unsure.update(change.moved, change.regrouped, self._map.instances_of(change.rows).tolist())
        if self._steps % CONFIDENCE_EVERY == 0:
            for instance in sorted(self._unsure - {0}):
                rows = self._map.rows(instance)
                self._draw_confidence(instance, self._map.index[rows], self._map.percent[rows] / 100)
            self._unsure.clear()

    def _draw_instance(self, instance: int, index: NDArray[np.int32], caption: str) -> None:
        self._seen.add(instance)
        cubes = self._cubes(index, colors=[instance_color(instance)])
        self._draw(
            entities.instance_path(instance),
            index,
            cubes,
            _values(instance=np.array([instance], np.int32), caption=[caption]),
        )

    def _draw_confidence(self, instance: int, index: NDArray[np.int32], confidence: NDArray[Any]) -> None:
        self._seen.add(instance)
        cubes = self._cubes(
            index, values=confidence.astype(np.float32), value_range=(0.0, 1.0), colormap=rr.components.Colormap.Viridis
        )
        self._draw(entities.confidence_path(instance), index, cubes)

    def _cubes(self, index: NDArray[np.int32], **look: Any) -> rr.VoxelGridMap:
        return rr.VoxelGridMap(index, voxel_size=[self._voxel_size] * 3, **look)

    def _draw(self, path: str, index: NDArray[np.int32], *what: Any) -> None:
        """Log what is there, or clear what was."""
        if len(index):
            self._log(path, *what)
            self._shown.add(path)
        elif path in self._shown:
            self._log(path, rr.Clear(recursive=True))
            self._shown.remove(path)

    def _log_finished(self, result: InstanceMap, frame: Frame) -> None:
        """Everything as it ends, which may differ from the last step: small things dropped, voxels smoothed."""
        captions = {summary.id: summary.caption for summary in result.instances}
        order = np.argsort(result.voxel_instance, kind="stable")
        for instance in sorted({*result.instance_id.tolist(), *self._seen}):
            first, last = np.searchsorted(result.voxel_instance, [instance, instance + 1], sorter=order)
            mine = order[first:last]
            self._draw_instance(instance, result.voxel_index[mine], captions.get(instance, ""))
            self._draw_confidence(instance, result.voxel_index[mine], result.voxel_confidence[mine])
        if self._images:
            self._log_rendered(frame, result.voxel_index, result.voxel_instance)


class _AbortedError(Exception):
    """Thrown through the open file so that it goes away."""


def _values(**columns: NDArray[Any] | Sequence[str]) -> rr.AnyValues:
    """Data of ours, typed here: what Rerun infers depends on what was logged before, and fails for empty lists."""
    return rr.AnyValues(
        **{
            name: pa.array(value) if isinstance(value, np.ndarray) else pa.array(value, pa.string())
            for name, value in columns.items()
        }
    )


def _pinhole(camera: Intrinsics) -> rr.Pinhole:
    return rr.Pinhole(
        focal_length=(camera.fx, camera.fy),
        principal_point=(camera.cx + 0.5, camera.cy + 0.5),  # Rerun counts from the pixel's corner
        resolution=(camera.width, camera.height),
        image_plane_distance=0.5,
        color=PATH_COLOR,
    )


def _check_whole(path: Path) -> None:
    """Rerun writes in a thread of its own, and tells nobody when the disk is full."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 64))
        if END_OF_FILE not in file.read():
            raise OSError("Rerun did not write it to its end; is the disk full?")
