"""Every step of the mapper as a Rerun recording: what the camera saw, what was decided, what the map became.

The observer keeps its own copy of the map (`LiveMap`) and logs only what changed. Drawings of instances may be a few
voxels behind (`Redraw` says how many); the end is exact.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import rerun as rr

from openvox.core.errors import OutputError
from openvox.core.types import Event, Frame, InstanceMap, Step
from openvox.formats.atomic import partial_file
from openvox.view import decision_table, entities, viewer
from openvox.view.blueprint import blueprint, opening, overview
from openvox.view.decision_graph import decision_graph
from openvox.view.labels import Captions
from openvox.view.live_map import LiveMap
from openvox.view.lives import Lives, dropped
from openvox.view.rerun_instances import Instances
from openvox.view.rerun_lives import Lanes
from openvox.view.rerun_pictures import Images, Pictures
from openvox.view.rerun_values import PATH_COLOR, pinhole, values
from openvox.view.rrd_file import check_whole
from openvox.view.viewpoint import world_from_color

BATCHES = rr.ChunkBatcherConfig(flush_tick=3600.0, flush_num_bytes=1 << 22, flush_num_rows=100_000)
"""Each chunk of an entity costs 1 to 2 kB, and Rerun's default ends one after a fifth of a second."""
LEVELS = {"new": rr.TextLogLevel.INFO, "confirmed": rr.TextLogLevel.INFO, "dropped": rr.TextLogLevel.ERROR}
"""Of events; the others are warnings."""


class RerunObserver:
    """Writes `target` (.rrd) while steps come; the file appears when `close` is called, and not at all after `abort`.

    target: or the URL of a viewer, which is shown the steps instead; InputError where none listens.
    voxel_size: metres. images: "none", "jpeg" (colour as JPEG, no depth) or "all". every: draw the map and log pictures
    at each so many-th step only; decisions, events and statistics are logged at all. camera: False where steps come
    without true poses: neither camera nor pictures are logged. earlier: the map that the run goes on from, whose voxels
    the first step tells. stages: asked after each step for the milliseconds of each stage, always the same ones.
    Use it as a context manager: leaving it before `close` aborts. Raises OutputError where the file cannot be written.

    Steps may be rebuilt from a trace. Read of a step: frame.index and stamp_ns; looked; decisions and their masks'
    caption and label; events; changes (all but `share`); instance_of of every fragment; voxels. Only with images: the
    masks' pixels, frame.color, frame.depth. `milliseconds` is the time that each step took here.
    """

    def __init__(
        self,
        target: Path | str,
        *,
        voxel_size: float,
        images: Images = "jpeg",
        every: int = 1,
        camera: bool = True,
        earlier: InstanceMap | None = None,
        stages: Callable[[], Mapping[str, float]] | None = None,
    ) -> None:
        self.milliseconds: list[float] = []
        self._every, self._stages, self._steps = every, stages, 0
        self._map = LiveMap()
        self._captions, self._lives = Captions(earlier), Lives(earlier)
        self._camera: Frame | None = None  # the last one with a true pose
        self._frame: Frame | None = None
        batches = BATCHES if isinstance(target, Path) else None  # who watches does not want to wait
        self._recording = rr.RecordingStream(entities.APPLICATION, send_properties=False, batcher_config=batches)
        self._partial: Path | None = None
        self._has_camera, self._with_pictures = camera, camera and images != "none"
        self._open(target)
        self._lanes = Lanes(self._recording, self._captions, watched=isinstance(target, str))
        self._instances = Instances(self._log, voxel_size, self._map, self._captions)
        self._pictures = (
            Pictures(self._log, images, voxel_size, self._map, self._captions) if self._with_pictures else None
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.abort()

    def on_step(self, step: Step) -> None:
        """Log one frame; nothing of the step is changed. Raises OutputError where the file cannot be written."""
        begin = time.perf_counter()
        with self._refusals():
            self._log_step(step)
        self.milliseconds.append(1000 * (time.perf_counter() - begin))

    def _log_step(self, step: Step) -> None:
        self._at(step.frame)
        drawn = self._steps % self._every == 0
        self._steps += 1
        if self._has_camera:
            self._log_camera(step.frame)
        change = self._map.apply(step)
        self._captions.add(step)
        self._log_decisions(step)
        self._lanes.add(step.frame, self._lives.changes(step))
        self._log_statistics(step)
        self._instances.log(step, change, drawn)
        if self._pictures is not None:
            if drawn:
                self._pictures.log(step)
            elif self._every > 1 and (self._steps - 1) % self._every == 1:
                self._pictures.clear()

    def close(self, result: InstanceMap | None) -> None:
        """Log the finished map at the last frame and complete the file; None: as the last step left it.

        Raises OutputError."""
        with self._file, self._refusals():
            pictured: tuple[int, ...] = ()
            if self._frame is not None and result is not None:
                pictured = self._log_finished(self._frame, result)
            elif self._frame is not None:
                self._instances.finish_without()
                self._lanes.finish({})
            eye = overview(result) if result is not None and self._frame is not None else None
            layout = blueprint(eye, pictures=self._with_pictures, pictured=pictured)
            # in a file it takes the place of the opening one; who watches keeps what he has arranged
            self._recording.send_blueprint(layout, make_active=self._partial is not None)
            self._recording.flush()
            self._recording.disconnect()
            if self._partial is not None:
                check_whole(self._partial)

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

    def _open(self, target: Path | str) -> None:
        self._path, self._file = target, ExitStack()
        if isinstance(target, str):
            viewer.check_url(target)
            self._recording.connect_grpc(target, default_blueprint=blueprint(pictures=self._with_pictures))
        else:
            with ExitStack() as stack:
                self._partial = stack.enter_context(partial_file(target))
                try:
                    self._recording.save(self._partial, default_blueprint=opening(pictures=self._with_pictures))
                except RuntimeError as error:  # what Rerun makes of the system's refusal
                    raise OSError(str(error)) from error
                self._file = stack.pop_all()
        self._recording.set_log_time_enabled(False)
        self._recording.set_log_tick_enabled(False)
        self._recording.send_recording_name("live" if isinstance(target, str) else target.stem)
        self._log(entities.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log(entities.INSTANCE_COUNT, rr.SeriesLines(names=["instances"]), static=True)
        self._log(entities.VOXEL_COUNT, rr.SeriesLines(names=["voxels"]), static=True)
        names = ["best A minus threshold", "best A minus second"]
        self._log(entities.MARGINS, rr.SeriesLines(names=names, colors=[(255, 112, 67), (66, 165, 245)]), static=True)

    def _log(self, path: str, *what: Any, static: bool = False) -> None:
        self._recording.log(path, *what, static=static)

    def _at(self, frame: Frame) -> None:
        self._frame = frame
        self._recording.set_time(entities.FRAME, sequence=frame.index)
        self._recording.set_time(entities.SENSOR_TIME, timestamp=np.datetime64(frame.stamp_ns, "ns"))

    def _log_camera(self, frame: Frame) -> None:
        """The frustum, and this frame's piece of the trajectory."""
        last, self._camera = self._camera, frame
        camera, pose = frame.rig.color, world_from_color(frame)
        if last is None or last.rig.color != camera:
            self._log(entities.CAMERA, pinhole(camera))
        self._log(entities.CAMERA, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
        piece = [pose[:3, 3] if last is None else world_from_color(last)[:3, 3], pose[:3, 3]]
        self._log(entities.TRAJECTORY, rr.LineStrips3D([piece], colors=[PATH_COLOR], radii=[0.006]))

    def _log_decisions(self, step: Step) -> None:
        table = rr.TextDocument(decision_table.markdown(step), media_type=rr.MediaType.MARKDOWN)
        self._log(entities.DECISION_TABLE, table)
        self._log(entities.DECISION_DATA, values(**decision_table.columns(step)))
        self._log(entities.CANDIDATES, values(**decision_table.candidate_columns(step)))
        graph = decision_graph(step, self._captions.of)
        if graph.ids:
            nodes = rr.GraphNodes(graph.ids, positions=graph.positions, colors=graph.colors, labels=graph.labels)
            self._log(entities.GRAPH, nodes, rr.GraphEdges(graph.edges, graph_type="undirected"))
        else:
            self._log(entities.GRAPH, rr.Clear(recursive=False))
        self._log_events(step.events)

    def _log_events(self, events: Iterable[Event]) -> None:
        for event in events:
            others = f" with {', '.join(map(str, event.others))}" if event.others else ""
            caption = f" ({self._captions.of(event.instance)})".replace(" ()", "")
            text = f"{event.kind} {event.instance}{caption}{others}: {event.text}"
            self._log(entities.EVENTS, rr.TextLog(text, level=LEVELS.get(event.kind, rr.TextLogLevel.WARN)))

    def _log_statistics(self, step: Step) -> None:
        self._log(entities.INSTANCE_COUNT, rr.Scalars(len(self._map.populated())))
        self._log(entities.VOXEL_COUNT, rr.Scalars(step.voxels))
        margins = decision_table.margins(step)
        if margins is not None:
            self._log(entities.MARGINS, rr.Scalars(margins))
        times = self._stages() if self._stages and step.looked else {}
        if times:
            if self._steps == 1:
                self._log(entities.MILLISECONDS, rr.SeriesLines(names=list(times)), static=True)
            self._log(entities.MILLISECONDS, rr.Scalars(list(times.values())))

    def _log_finished(self, frame: Frame, result: InstanceMap) -> tuple[int, ...]:
        """Everything as it ends, which may differ from the last step: small things dropped, voxels smoothed.

        Returns the instances that have their best views beside their voxels: a layout must know of them."""
        self._instances.finish(result)
        self._lanes.add(frame, dropped(result.events))
        self._lanes.finish({summary.id: summary.caption for summary in result.instances})
        self._log_events(result.events)
        if self._pictures is None or self._camera is None:
            return ()
        return self._pictures.finish(result, self._camera, beside=self._partial is not None)


class _AbortedError(Exception):
    """Thrown through the open file so that it goes away."""
