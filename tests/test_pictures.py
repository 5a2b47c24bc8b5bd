"""Pictures without a screen: what is drawn is what the map holds."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from maps import small_map
from test_rerun_observer import PARAMETERS, masks_of
from worlds import tiny_frames

from openvox.core.colors import instance_color
from openvox.core.errors import OutputError
from openvox.mapper.mapper import Mapper
from openvox.view.pictures import draw_frame, draw_map


def hues(path: Path) -> set[int]:
    """Hues of the strong colours in a picture, in steps of 4 degrees."""
    image = cv2.imread(str(path))
    assert image is not None
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    return {int(hue) // 2 for hue in hsv[(hsv[..., 1] > 100) & (hsv[..., 2] > 60)][:, 0]}


def hue_of(instance: int) -> int:
    rgb = np.array([[instance_color(instance)[:3]]], np.uint8)
    return int(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV)[0, 0, 0]) // 2


def test_the_map_is_drawn_in_the_size_asked_for_with_its_instances_in_their_colours(tmp_path: Path) -> None:
    mapper = Mapper(PARAMETERS)
    for frame in tiny_frames(4):
        mapper.step(frame, masks_of(frame))
    result = mapper.finish()
    draw_map(result, tmp_path / "map.png", width=640, height=400)
    image = cv2.imread(str(tmp_path / "map.png"))
    assert image is not None
    assert image.shape == (400, 640, 3)
    drawn = hues(tmp_path / "map.png")
    seen = [i for i in result.instance_id.tolist() if {hue_of(i) - 1, hue_of(i), hue_of(i) + 1} & drawn]
    assert seen


def test_a_frame_shows_detected_beside_rendered_masks(tmp_path: Path) -> None:
    mapper, frame = Mapper(PARAMETERS), tiny_frames(1)[0]
    step = mapper.step(frame, masks_of(frame))
    draw_frame(frame, step.masks, step.decisions, mapper.finish(), tmp_path / "frame.png")
    image = cv2.imread(str(tmp_path / "frame.png"))
    assert image is not None
    assert image.shape[1] > 2 * frame.rig.color.width


def test_a_picture_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere/map\.png could not be written"):
        draw_map(small_map(), tmp_path / "nowhere" / "map.png")
