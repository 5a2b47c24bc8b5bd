"""Instances in Rerun: their voxels by instance, confidence and entropy, captions, boxes, and the table of them all."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from openvox.core.colors import instance_color
from openvox.core.types import InstanceMap, Step
from openvox.view import entities, instance_table
from openvox.view.instance_table import Row, histogram
from openvox.view.labels import Captions, shortened
from openvox.view.live_map import Change, LiveMap
from openvox.view.redraw import Redraw
from openvox.view.rerun_values import Log, values
from openvox.view.votes import finished_entropies

GRAIN = 8
"""Confidence and entropy are drawn in so many steps from 0 to 1, which a file can hold in little room."""
LETTERS = 20


class Instances:
    """Logs what became of the instances, each as an entity of its own."""

    def __init__(self, log: Log, voxel_size: float, live: LiveMap, captions: Captions) -> None:
        self._log, self._voxel_size, self._map, self._captions = log, voxel_size, live, captions
        self._redraw = Redraw()
        self._seen: set[int] = set()  # instances that were drawn at some time
        self._named: dict[int, str] = {}  # caption of those that show something now
        self._bounds: dict[int, NDArray[np.float64]] = {}  # (2, 3), metres, of those, as drawn

    def log(self, step: Step, change: Change, drawn: bool) -> None:
        """What one step changed. drawn: whether voxels are drawn at this step."""
        self._redraw.note(change)
        due = self._redraw.due(self._map) if drawn else []
        for instance in due:
            self._draw_live(instance)
        if due:
            self._log_captions()
        self._log_touched(step)

    def finish(self, result: InstanceMap) -> None:
        """Everything as it ends. Confidence, entropy and the table are for all frames: each costs as much as a map."""
        summaries = {summary.id: summary for summary in result.instances}
        entropy = finished_entropies(result)
        order = np.argsort(result.voxel_instance, kind="stable")
        rows = []
        for instance in sorted({*result.instance_id.tolist(), *self._seen}):
            first, last = np.searchsorted(result.voxel_instance, [instance, instance + 1], sorter=order)
            mine = order[first:last]
            index, confidence = result.voxel_index[mine], result.voxel_confidence[mine]
            summary = summaries.get(instance)
            drawn = index[self._map.order_of(index)]
            self._draw_instance(instance, drawn, summary.caption if summary else "")
            self._draw_sureness(instance, index, confidence, entropy[mine])
            if summary:
                rows.append(Row(instance, summary.captions, summary.observations, histogram(confidence)))
        self._log_captions()
        self._log_table(rows)

    def finish_without(self) -> None:
        """What waited to be drawn."""
        for instance in self._redraw.waiting():
            self._draw_live(instance)
        self._log_captions()
        table = []
        for instance in sorted(set(self._map.populated()) - {0}):
            rows = self._map.rows(instance)
            share, entropy = self._map.sureness(rows)
            self._draw_sureness(instance, self._map.index_of(rows), share, entropy)
            captions, observations = self._captions.votes(instance), self._captions.observations(instance)
            table.append(Row(instance, captions, observations, histogram(share)))
        self._log_table(table)

    def _draw_live(self, instance: int) -> None:
        self._draw_instance(instance, self._map.index_of(self._map.rows(instance)), self._captions.of(instance))

    def _draw_instance(self, instance: int, index: NDArray[np.int32], caption: str) -> None:
        """Its voxels; no voxels where it showed some. A row always has all columns: else chunks are torn apart."""
        if len(index):
            self._bounds[instance] = np.array([index.min(0), index.max(0) + 1]) * self._voxel_size
            self._named[instance] = caption
        elif self._named.pop(instance, None) is None:
            return
        self._seen.add(instance)
        cubes = self._cubes(index, colors=[instance_color(instance)])
        about = values(instance=np.array([instance], np.int32), caption=[caption])
        self._log(entities.instance_path(instance), cubes, about)

    def _log_captions(self) -> None:
        """Id and caption in the middle of each instance, as one entity: many small ones would fill the file."""
        shown = sorted(self._named)
        names = rr.Points3D(
            np.array([self._bounds[instance].mean(0) for instance in shown]).reshape(-1, 3),
            radii=[0.01],
            colors=[instance_color(instance) for instance in shown],
            labels=[self._label(instance) for instance in shown],
            show_labels=True,
        )
        self._log(entities.CAPTIONS, names)

    def _label(self, instance: int) -> str:
        return f"{instance}: {shortened(self._named[instance], LETTERS)}"

    def _log_touched(self, step: Step) -> None:
        """A box around each instance to which a mask of this frame went, as it was drawn last."""
        instances = sorted({decision.instance for decision in step.decisions} & self._named.keys())
        corners = np.array([self._bounds[instance] for instance in instances]).reshape(-1, 2, 3)
        boxes = rr.Boxes3D(
            mins=corners[:, 0],
            sizes=corners[:, 1] - corners[:, 0],
            colors=[instance_color(instance) for instance in instances],
            radii=[0.004],
            fill_mode=rr.components.FillMode.MajorWireframe,
            labels=[self._label(instance) for instance in instances],
            show_labels=True,
        )
        self._log(entities.TOUCHED, boxes)

    def _log_table(self, rows: list[Row]) -> None:
        table = rr.TextDocument(instance_table.markdown(rows), media_type=rr.MediaType.MARKDOWN)
        self._log(entities.INSTANCE_TABLE, table, static=True)

    def _draw_sureness(
        self, instance: int, index: NDArray[np.int32], share: NDArray[np.float32], entropy: NDArray[np.float32]
    ) -> None:
        """Colours and range of the values are said by the layout."""
        if len(index):
            for path, amount in (
                (entities.confidence_path(instance), share),
                (entities.entropy_path(instance), entropy),
            ):
                grains = (np.rint(amount * GRAIN) / GRAIN).astype(np.float32)
                order = np.argsort(grains, kind="stable")  # equal ones together take next to no room
                self._log(path, self._cubes(index[order], values=grains[order]), static=True)

    def _cubes(self, index: NDArray[np.int32], **look: Any) -> rr.VoxelGridMap:
        return rr.VoxelGridMap(index, voxel_size=[self._voxel_size] * 3, **look)
