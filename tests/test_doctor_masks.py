"""doctor on perception files: frames without masks, masks over depth edges, covering masks, captions that change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from worlds import CAMERA, tiny_frames, truth_masks

from openvox.apps.doctor import doctor
from openvox.core.types import Frame, Mask
from openvox.formats.perception import FrameMasks, PerceptionWriter
from openvox.formats.recording import RecordingWriter, recording_info

N = 12


def unit(seed: int) -> np.ndarray[tuple[int], np.dtype[np.float32]]:
    vector = np.random.default_rng(seed).normal(size=16)
    return (vector / np.linalg.norm(vector)).astype(np.float32)


def good_masks(frame: Frame) -> tuple[Mask, ...]:
    return tuple(replace(mask, embedding=unit(i)) for i, mask in enumerate(truth_masks(frame)))


def perceived(folder: Path, masks_of: Callable[[Frame], tuple[Mask, ...]]) -> Path:
    """A recording of twelve frames, and what was detected in it."""
    with RecordingWriter(folder / "a.mcap", source="test") as writer:
        for frame in tiny_frames(N):
            writer.add(frame)
    path = folder / "a.perception.mcap"
    with PerceptionWriter(path, recording_info(folder / "a.mcap"), stages=[], encoder="test", dimensions=16) as out:
        for frame in tiny_frames(N):
            out.add(FrameMasks(frame.index, frame.stamp_ns, "0" * 64, masks_of(frame), (CAMERA.height, CAMERA.width)))
    return path


def said(path: Path) -> list[str]:
    """The first words of each finding; all are of the code `masks`."""
    findings = doctor(path).findings
    assert {one.code for one in findings} <= {"masks"}
    return [" ".join(one.what.split()[:6]) for one in findings]


def test_nothing_is_said_of_masks_that_follow_the_objects(tmp_path: Path) -> None:
    result = doctor(perceived(tmp_path, good_masks))
    assert (result.kind, result.frames, result.findings, result.notes) == ("perception", N, (), ())


def test_frames_without_masks_are_counted(tmp_path: Path) -> None:
    path = perceived(tmp_path, lambda frame: () if frame.index % 3 == 2 else good_masks(frame))
    assert said(path) == ["4 of 12 frames have no"]
    assert "the first is frame 2" in doctor(path).findings[0].what


def test_one_frame_without_masks_is_no_fault(tmp_path: Path) -> None:
    assert said(perceived(tmp_path, lambda frame: () if frame.index == 5 else good_masks(frame))) == []


def test_masks_that_cover_most_of_the_picture_are_counted(tmp_path: Path) -> None:
    everything = Mask.from_bitmap(np.ones((CAMERA.height, CAMERA.width), np.bool_), embedding=unit(9))
    path = perceived(tmp_path, lambda frame: (*good_masks(frame), *([everything] if frame.index == 3 else [])))
    assert said(path) == ["1 of 12 frames have a"]


def test_masks_over_edges_of_depth_are_counted(tmp_path: Path) -> None:
    def spilling(frame: Frame) -> tuple[Mask, ...]:
        """Upright strips over all the picture, which reaches from near floor to far."""
        strips = []
        for x in range(0, CAMERA.width, 8):
            bitmap = np.zeros((CAMERA.height, CAMERA.width), np.bool_)
            bitmap[:, x : x + 8] = True
            strips.append(Mask.from_bitmap(bitmap, caption="strip", embedding=unit(1)))
        return tuple(strips)

    path = perceived(tmp_path, spilling)
    assert [" ".join(text.split()[2:6]) for text in said(path)] == ["48 masks lie over", "48 masks fill their"]
    (tmp_path / "a.mcap").unlink()
    result = doctor(path)
    assert [one.what.split()[3:6] for one in result.findings] == [["masks", "fill", "their"]]
    assert result.notes == ("its recording is not beside it, so that masks were not laid over depth",)


def test_boxes_that_stand_in_for_masks_are_counted(tmp_path: Path) -> None:
    def boxes(frame: Frame) -> tuple[Mask, ...]:
        return tuple(
            replace(mask, bits=np.packbits(np.ones((mask.box[3] - mask.box[1], mask.box[2] - mask.box[0]), np.bool_)))
            for mask in good_masks(frame)
        )

    assert said(perceived(tmp_path, boxes)) == ["36 of 36 masks fill their"]


@pytest.mark.parametrize("vectors_change", [True, False])
def test_captions_that_change_every_frame_are_counted(tmp_path: Path, vectors_change: bool) -> None:
    def renamed(frame: Frame) -> tuple[Mask, ...]:
        return tuple(
            replace(mask, caption=f"word {frame.index}", embedding=unit(100 * frame.index * vectors_change + m))
            for m, mask in enumerate(good_masks(frame))
        )

    assert said(perceived(tmp_path, renamed)) == ["Captions change from frame to frame:"]


def test_nothing_is_said_of_the_bundled_perception() -> None:
    path = Path(__file__).resolve().parents[1] / "recordings" / "living_demo.perception.mcap"
    assert doctor(path).findings == ()
