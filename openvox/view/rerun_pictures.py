"""What a frame's pixels show in Rerun: the picture and its masks, depth, the map from the same pose, masks in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from openvox.core.colors import instance_color
from openvox.core.types import Frame, InstanceMap, Mask, Step
from openvox.formats.images import decode_color, encode_jpeg
from openvox.view import entities
from openvox.view.best_views import BestViews, Picture, Sheet, sheet
from openvox.view.labels import (
    BACKGROUND,
    NOTHING,
    UNASSIGNED,
    Captions,
    Label,
    caption_votes,
    detected_labels,
    instance_labels,
    mask_image,
    present,
)  # fmt: skip
from openvox.view.lettering import WHITE, Note, place
from openvox.view.live_map import LiveMap
from openvox.view.render import render_rows, take_rows
from openvox.view.rerun_values import Log, label_image, values
from openvox.view.viewpoint import world_from_color

Images = Literal["none", "jpeg", "all"]
QUALITY, VIEW_QUALITY = 75, 85
REGION_STEP = 4
"""Every so many pixels across and down are asked in which voxel they lie."""
NAME_SCALE = 0.8 / 640
"""Of letters on a picture, by its width: about as large as the viewer's in the layout at 1600x900."""
STEPS = 10
"""Classes of confidence in pictures."""


class Pictures:
    """Logs the pictures of frames. images: jpeg = without depth and with colour as JPEG; all = as they are."""

    def __init__(self, log: Log, images: Images, voxel_size: float, live: LiveMap, captions: Captions) -> None:
        self._log, self._images, self._voxel_size = log, images, voxel_size
        self._map, self._captions = live, captions
        self._views = BestViews()
        self._regions = 0
        for picture in (entities.COLOR, entities.MASKS, entities.MASK_NAMES):
            log(picture, rr.CoordinateFrame(entities.CAMERA_FRAME), static=True)

    def log(self, step: Step) -> None:
        """All pictures of one frame."""
        frame, camera = step.frame, step.frame.rig.color
        self._views.add(step)
        self._log_color(frame)
        numbers = mask_image(step.masks, camera.height, camera.width)
        instance_of = {decision.mask: decision.instance for decision in step.decisions}
        labels = detected_labels(step.masks, instance_of)
        self._log(entities.MASKS, *label_image(numbers, labels))
        self._log_names(step.masks, labels, numbers.shape)
        if self._images == "all":
            self._log(entities.DEPTH, rr.DepthImage(frame.depth, meter=1000.0))
        self._log_regions(step, numbers, instance_of)
        self._log_rendered(frame)

    def clear(self) -> None:
        """No picture of an earlier frame stays: Clear alone leaves a coded one standing."""
        self._log(entities.REGIONS, rr.Clear(recursive=True))
        for path in (entities.MASKS, entities.MASK_NAMES, entities.DEPTH):
            self._log(path, rr.Clear(recursive=False))
        for path in (entities.RENDERED, entities.RENDERED_CONFIDENCE):
            self._log(path, rr.Clear(recursive=False))
        self._log(entities.COLOR, rr.EncodedImage.from_fields(clear_unset=True))

    def finish(self, result: InstanceMap, frame: Frame, beside: bool) -> tuple[int, ...]:
        """The finished map from the last pose, and where every instance was seen best.

        beside: also lay its views beside each instance's voxels. Returns the instances that have views there."""
        rows = render_rows(result.voxel_index, self._voxel_size, world_from_color(frame), frame.rig.color)
        self._log_views(rows, result.voxel_instance, result.voxel_confidence)
        table = self._map.instance_of
        strips = self._views.strips(result.instance_id.tolist(), lambda f: int(table[f]) if f < len(table) else 0)
        if not strips:
            return ()
        summaries = {summary.id: summary for summary in result.instances}
        names = {instance: f"{instance}: {summaries[instance].caption}" for instance in strips}
        self._log_sheet(sheet(strips), names)
        for instance, strip in strips.items() if beside else ():
            said = values(votes=["; ".join(caption_votes(summaries[instance].captions))])
            self._log(entities.instance_path(instance), _jpeg(strip), said, static=True)
        return tuple(strips) if beside else ()

    def _log_sheet(self, one: Sheet, names: Mapping[int, str]) -> None:
        self._log(entities.BEST_VIEWS, _jpeg(one.picture), static=True)
        boxes = rr.Boxes2D(
            array=np.array(list(one.boxes.values()), np.float32),
            array_format=rr.Box2DFormat.XYWH,
            labels=[names[instance] for instance in one.boxes],
            colors=[instance_color(instance) for instance in one.boxes],
            show_labels=False,  # they would hide the pictures: told where one points
        )
        self._log(entities.BEST_VIEW_NAMES, boxes, static=True)

    def _log_names(self, masks: Sequence[Mask], labels: Mapping[int, Label], shape: tuple[int, int]) -> None:
        """Number, caption and instance at each mask, the larger masks first; where no place is free the number alone.

        Points, as labels of boxes are broken to the box's width. shape: of the picture, (height, width)."""
        notes = [
            Note(labels[m].short, ((mask.box[0] + mask.box[2]) // 2, (mask.box[1] + mask.box[3]) // 2))
            for m, mask in enumerate(masks)
        ]
        larger = sorted(range(len(masks)), key=lambda m: (-masks[m].area, m))
        boxes = dict(place(shape, [notes[m] for m in larger], NAME_SCALE * shape[1]))
        spots, texts = [], []
        for m, note in enumerate(notes):
            left, top, right, bottom = boxes.get(note, (*note.point, *note.point))
            spots.append(((left + right) / 2, (top + bottom) / 2))
            texts.append(note.text if note in boxes else str(m))
        names = rr.Points2D(
            np.array(spots, np.float32).reshape(-1, 2),
            labels=texts,
            colors=[WHITE],
            radii=[-1.0],  # in points of the screen
            show_labels=True,
        )
        self._log(entities.MASK_NAMES, names)

    def _log_color(self, frame: Frame) -> None:
        if not frame.color:
            return
        contents, kind = frame.color, frame.color_format
        if self._images == "jpeg" and kind != "jpeg":
            contents, kind = encode_jpeg(decode_color(frame), QUALITY), "jpeg"
        self._log(entities.COLOR, rr.EncodedImage(contents=contents, media_type=f"image/{kind}"))

    def _log_rendered(self, frame: Frame) -> None:
        """The map as the colour camera sees it."""
        index = self._map.index()
        rows = render_rows(index, self._voxel_size, world_from_color(frame), frame.rig.color)
        confidence = np.zeros(len(index), np.float32)
        seen = np.array(present(rows), np.int64)
        confidence[seen] = self._map.sureness(seen)[0]
        self._log_views(rows, self._map.instances(), confidence)

    def _log_views(
        self, rows: NDArray[np.int32], instances: NDArray[np.int32], confidence: NDArray[np.float32]
    ) -> None:
        image = take_rows(instances, rows, NOTHING)
        self._log(entities.RENDERED, *label_image(image, instance_labels(present(image), self._captions.of)))
        steps = np.minimum((confidence * STEPS).astype(np.int32), STEPS - 1) + 1
        image = take_rows(np.where(instances > 0, steps, 0).astype(np.int32), rows, NOTHING)
        self._log(entities.RENDERED_CONFIDENCE, *label_image(image, CONFIDENCES))

    def _log_regions(self, step: Step, numbers: NDArray[np.int32], instance_of: dict[int, int]) -> None:
        """The voxels under each mask, one entity a mask, to be picked and hidden one by one."""
        index, number = _places(step.frame, numbers, self._voxel_size)
        for mask in range(max(self._regions, len(step.masks))):
            path = entities.region_path(mask)
            mine = np.unique(index[number == mask], axis=0)
            if not len(mine):
                self._log(path, rr.Clear(recursive=False))
                continue
            instance = instance_of.get(mask, 0)
            color = instance_color(instance) if instance else UNASSIGNED
            cubes = rr.VoxelGridMap(mine, voxel_size=[self._voxel_size] * 3, colors=[color])
            about = {name: np.array([value], np.int32) for name, value in (("mask", mask), ("instance", instance))}
            self._log(path, cubes, values(**about, caption=[step.masks[mask].caption]))
        self._regions = len(step.masks)


def _jpeg(picture: Picture) -> rr.EncodedImage:
    return rr.EncodedImage(contents=encode_jpeg(picture, VIEW_QUALITY), media_type="image/jpeg")


def _places(frame: Frame, numbers: NDArray[np.int32], voxel_size: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Voxels (n, 3) in which some of the depth pixels lie, and each one's mask, -1 = none. For drawing only."""
    depth, color = frame.rig.depth, frame.rig.color
    v, u = np.mgrid[: depth.height : REGION_STEP, : depth.width : REGION_STEP]
    z = frame.depth[::REGION_STEP, ::REGION_STEP] / 1000.0
    points = np.stack([(u - depth.cx) / depth.fx * z, (v - depth.cy) / depth.fy * z, z], -1)[z > 0]
    back = np.linalg.inv(frame.rig.depth_from_color.matrix())
    seen = points @ back[:3, :3].T + back[:3, 3]
    seen, points = seen[seen[:, 2] > 0], points[seen[:, 2] > 0]
    x = np.rint(seen[:, 0] / seen[:, 2] * color.fx + color.cx).astype(np.int64)
    y = np.rint(seen[:, 1] / seen[:, 2] * color.fy + color.cy).astype(np.int64)
    inside = (x >= 0) & (x < color.width) & (y >= 0) & (y < color.height)
    pose = frame.world_from_depth.matrix()
    world = points[inside] @ pose[:3, :3].T + pose[:3, 3]
    return np.floor(world / voxel_size).astype(np.int32), numbers[y[inside], x[inside]]


def _confidences() -> dict[int, Label]:
    shades = cv2.applyColorMap(np.linspace(0, 255, STEPS).astype(np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)
    labels = {0: Label("background", BACKGROUND)}
    for step, (blue, green, red) in enumerate(shades[:, 0].tolist()):
        labels[step + 1] = Label(f"confidence {step / STEPS:.1f} to {(step + 1) / STEPS:.1f}", (red, green, blue))
    return labels


CONFIDENCES = _confidences()
"""Class of each step of confidence to its name and colour."""
