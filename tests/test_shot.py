"""shot: pictures without a screen where the machine can, and a sentence where it cannot."""

from __future__ import annotations

import ctypes.util
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from maps import small_map
from worlds import tiny_frames

from openvox.apps.info import info
from openvox.apps.shot import shot
from openvox.apps.view import as_rrd, view
from openvox.cli.commands.shot import parsed_size
from openvox.core.errors import InputError, OutputError
from openvox.formats.map_npz import write_map
from openvox.formats.recording import RecordingWriter
from openvox.view.screenshot import is_blank, vulkan_devices

needs_vulkan = pytest.mark.skipif(vulkan_devices() == 0, reason="no Vulkan device: install mesa-vulkan-drivers")


@pytest.fixture(scope="module")
def map_file(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A map of four voxels."""
    path = tmp_path_factory.mktemp("shot") / "a.map.npz"
    write_map(path, small_map())
    return path


@needs_vulkan
def test_a_map_becomes_a_picture_of_the_size_asked_for(map_file: Path, tmp_path: Path) -> None:
    made = shot(map_file, tmp_path / "a.png", size=(640, 400))
    picture = cv2.imread(str(tmp_path / "a.png"))
    assert picture is not None
    assert picture.shape == (400, 640, 3)
    assert not is_blank(np.asarray(picture, np.uint8))
    assert (made["kind"], made["frame"], made["size"]) == ("map", None, [640, 400])


@needs_vulkan
def test_a_wrong_view_or_frame_is_one_sentence_and_no_picture(map_file: Path, tmp_path: Path) -> None:
    rrd = as_rrd(map_file, tmp_path / "a.rrd")
    with pytest.raises(
        InputError, match=r"a.rrd has no view 'nowhere'; its views: Instances; Map with .*; Map, coloured by"
    ):
        shot(rrd, tmp_path / "a.png", view="nowhere")
    with pytest.raises(InputError, match=r"a.rrd has no frames, as a map has none"):
        shot(rrd, tmp_path / "a.png", frame=3)
    assert not list(tmp_path.glob("a.png*"))


def test_a_machine_without_vulkan_is_told_what_to_install(
    map_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: None)
    with pytest.raises(
        InputError, match=r"no picture can be drawn here: .* install mesa-vulkan-drivers and libvulkan1"
    ):
        shot(map_file, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())


def test_a_picture_never_replaces_what_it_is_of(map_file: Path) -> None:
    before = map_file.read_bytes()
    with pytest.raises(OutputError, match="would be overwritten by what is made from it"):
        shot(map_file, map_file)
    assert map_file.read_bytes() == before


def test_a_foreign_file_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(InputError, match=r"a.txt is no recording, perception, map, trace or .rrd"):
        shot(tmp_path / "a.txt", tmp_path / "a.png")


@pytest.mark.parametrize("length", [4, 60, 2000])
def test_a_cut_file_of_rerun_is_one_sentence_at_once(map_file: Path, tmp_path: Path, length: int) -> None:
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(as_rrd(map_file, tmp_path / "a.rrd").read_bytes()[:length])
    for reading in (partial(shot, cut, tmp_path / "a.png"), partial(info, cut), partial(view, [cut], web=True)):
        with pytest.raises(InputError, match=r"cut.rrd is cut off or damaged \(.+\); make it again with --rerun"):
            reading()
    assert not (tmp_path / "a.png").exists()


def test_an_empty_window_is_no_picture() -> None:
    window = np.full((200, 200, 3), 13, np.uint8)
    assert is_blank(window)
    window[50:80, 50:80] = 200
    assert not is_blank(window)


def test_a_size_is_two_numbers_that_a_window_can_have() -> None:
    assert parsed_size("1600x900") == (1600, 900)
    for text in ("1600", "axb", "0x0", "1600x900x3", "-5x900", "99999x900"):
        with pytest.raises(typer.BadParameter, match=r"expected WxH"):
            parsed_size(text)


@needs_vulkan
def test_a_view_behind_a_tab_is_drawn_alone_and_fills_the_picture(map_file: Path, tmp_path: Path) -> None:
    shown = [
        shot(map_file, tmp_path / f"{name}.png", view=name, size=(640, 400)) for name in ("by instance", "by confid")
    ]
    assert [one["size"] for one in shown] == [[640, 400]] * 2
    first, second = (cv2.imread(str(tmp_path / f"{name}.png")) for name in ("by instance", "by confid"))
    assert first is not None
    assert second is not None
    assert (first != second).any(-1).mean() > 0.01  # the same voxels in other colours


def test_what_cannot_be_shown_is_said_of_the_file_given_before_anything_is_drawn(
    map_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("openvox.apps.shot.as_rrd", None)
    with pytest.raises(InputError, match=r"^a.map.npz has no view 'nowhere'; its views: Instances; Map with .*"):
        shot(map_file, tmp_path / "a.png", view="nowhere")
    with pytest.raises(InputError, match=r"^a.map.npz has several views 'colour'"):
        shot(map_file, tmp_path / "a.png", view="colour")
    with pytest.raises(InputError, match=r"^a.map.npz has no frames"):
        shot(map_file, tmp_path / "a.png", frame=3)
    with pytest.raises(OutputError, match=r"a.png could not be written"):
        shot(map_file, tmp_path / "nowhere" / "a.png")
    with pytest.raises(OutputError, match=r"a.jpg would be a PNG under another name; let it end with .png"):
        shot(map_file, tmp_path / "a.jpg")
    with RecordingWriter(tmp_path / "a.mcap", source="test") as writer:
        for frame in tiny_frames(2):
            writer.add(frame)
    with pytest.raises(InputError, match=r"^a.mcap has frames 0 to 1; frame 2 is none of them"):
        shot(tmp_path / "a.mcap", tmp_path / "a.png", frame=2)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
