"""Pictures of the Rerun viewer without a screen: started, told what to show, waited for until nothing changes."""

from __future__ import annotations

import ctypes
import ctypes.util
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError
from openvox.formats.atomic import partial_file
from openvox.view import entities
from openvox.view.viewer import LOOPBACK, Process, free_port, running

PANELS = {
    "top_panel": "PanelBlueprint",
    "blueprint_panel": "PanelBlueprint",
    "selection_panel": "PanelBlueprint",
    "time_panel": "TimePanelBlueprint",
}
FRAME = (7, 71)
"""Pixels that the window has around a view that fills it."""
SETTLED = 1e-4
"""Share of pixels that may differ between two pictures of which nothing moved."""
QUIET_SECONDS = 6.0
"""So long after its first picture the messages of the viewer's start have left it."""
PATIENCE = 90.0
EMPTY_SECONDS = 12.0
"""After which a view of one colour is taken for an empty one."""
LOADING_SECONDS = 30.0
"""In which a file must show that it holds something."""
TRIES = 2
"""The software renderer is known to crash now and then."""
PACKAGES = "mesa-vulkan-drivers and libvulkan1 (Debian, Ubuntu) or mesa-vulkan-drivers and vulkan-loader (Fedora)"


class _ViewerDiedError(Exception):
    """The viewer ended, or never showed a picture."""


def take_shot(
    rrd: Path, out: Path, *, name: str, frame: int | None, view: str | None, size: tuple[int, int]
) -> dict[str, Any]:
    """Write a PNG of the whole layout, or of the view of that name, at a frame (None: the last one).

    name: of the file that the user gave, for errors. size: of the picture, (width, height). Returns what was shown:
    frame, view, size of the picture. Raises InputError: the machine cannot, or the file has no such frame or view;
    OutputError."""
    check_machine()
    for left in reversed(range(TRIES)):
        try:
            return _try_shot(rrd, out, name, frame, view, size)
        except _ViewerDiedError as error:
            if not left:
                raise InputError(
                    f"{name}: the Rerun viewer showed no picture in {TRIES} tries ({error}); install {PACKAGES}, "
                    "or try again when the machine is less busy"
                ) from None
    raise AssertionError("unreachable")


def check_machine() -> None:
    """Raises InputError where no picture can be drawn."""
    if vulkan_devices() == 0:
        raise InputError(f"no picture can be drawn here: there is no Vulkan device; install {PACKAGES}")


def vulkan_devices() -> int:
    """Number of devices that Vulkan finds, software included; 0 without a loader or driver."""
    name = ctypes.util.find_library("vulkan")
    if name is None:
        return 0
    try:
        vulkan = ctypes.CDLL(name)
    except OSError:
        return 0
    instance, count = ctypes.c_void_p(), ctypes.c_uint32()
    info = (ctypes.c_uint64 * 8)(1)  # VkInstanceCreateInfo: its type, and nothing asked for
    if vulkan.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)):
        return 0
    found = vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
    vulkan.vkDestroyInstance(instance, None)
    return 0 if found else count.value


def _try_shot(
    rrd: Path, out: Path, name: str, frame: int | None, view: str | None, size: tuple[int, int]
) -> dict[str, Any]:
    if view is not None:
        size = size[0] + FRAME[0], size[1] + FRAME[1]
    with _viewer(rrd, size) as (viewer, process, deadline):
        state = _loaded(viewer, name, process, deadline)
        view_id = None if view is None else _view_id(name, state, view)
        if view_id is not None:
            _show_alone(viewer, view_id)
        shown = _go_to(viewer, name, state, frame)
        picture = _settled(viewer, process, view_id, deadline)
        if picture is None:
            when = "" if shown is None else f" at frame {shown}"
            raise InputError(f"{name}: there is nothing in view {view!r}{when}; choose another --frame or --view")
    with partial_file(out) as partial:
        partial.write_bytes(picture)
    height, width = _pixels(picture).shape[:2]
    return {"frame": shown, "view": view, "size": [width, height]}


@contextmanager
def _viewer(rrd: Path, size: tuple[int, int]) -> Iterator[tuple[Any, Process, float]]:
    """A headless viewer with the file open, its process, and when patience ends."""
    from rerun.experimental import ViewerClient

    port, deadline = free_port(LOOPBACK), time.monotonic() + PATIENCE
    window = f"{size[0]}x{size[1]}"
    arguments = ["--headless", "--bind", LOOPBACK, "--port", str(port), "--window-size", window]
    with running([*arguments, "--hide-welcome-screen"]) as process:
        while True:
            try:
                viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
                viewer.open(str(rrd.resolve()))
                break
            except (ConnectionError, RuntimeError, OSError) as error:
                _check(process, deadline, error)
                time.sleep(0.2)
        yield viewer, process, deadline


def _check(process: Process, deadline: float, error: object) -> None:
    if process.poll() is not None:
        raise _ViewerDiedError(f"it ended with {process.returncode}")
    if time.monotonic() > deadline:
        raise _ViewerDiedError(f"nothing settled in {PATIENCE:.0f} s: {error}")


def _loaded(viewer: Any, name: str, process: Process, deadline: float) -> Any:
    """The viewer's state when all of the file has arrived. Raises InputError: nothing arrives."""
    before, given_up = None, time.monotonic() + LOADING_SECONDS
    while True:
        with suppress(ConnectionError, RuntimeError, OSError):
            state = viewer.get_state()
            if state.views and state.recordings and not state.loading and state.recordings == before:
                return state
            before = state.recordings
            if not before and not state.loading and time.monotonic() > given_up:
                raise InputError(f"{name} holds nothing that Rerun can show; is it whole? Make it again")
        _check(process, deadline, "loading")
        time.sleep(0.3)


def _go_to(viewer: Any, name: str, state: Any, frame: int | None) -> int | None:
    """Set the time; returns the frame, None for a file without frames. Raises InputError."""
    active = [found for found in state.recordings if found.store_id == state.active_recording]
    lines = [line for found in active for line in found.timelines if line.name == entities.FRAME]
    if not lines:
        check_frame(name, frame, None)
        return None
    first, last = lines[0].start, lines[0].end
    check_frame(name, frame, (first, last))
    chosen = last if frame is None else frame
    viewer.set_time(entities.FRAME, sequence=chosen, play_state="paused")
    return int(chosen)


def check_frame(name: str, frame: int | None, known: tuple[int, int] | None) -> None:
    """known: first and last frame of the file, None: it has none. Raises InputError."""
    if frame is None:
        return
    if known is None:
        raise InputError(f"{name} has no frames, as a map has none; leave --frame out")
    if not known[0] <= frame <= known[1]:
        raise InputError(f"{name} has frames {known[0]} to {known[1]}; frame {frame} is none of them")


def chosen_view(name: str, view: str, known: Iterable[str]) -> str:
    """The view of that name, or the only one whose name holds it, in any case. Raises InputError."""
    views = sorted(known)
    near = [found for found in views if view.casefold() in found.casefold()]
    if view in views or len(near) == 1:
        return view if view in views else near[0]
    raise InputError(f"{name} has {'several views' if near else 'no view'} {view!r}; its views: {'; '.join(views)}")


def _view_id(name: str, state: Any, view: str) -> str:
    ids = {found.name: str(found.view_id) for found in state.views}
    return ids[chosen_view(name, view, ids)]


def _show_alone(viewer: Any, view_id: str) -> None:
    """Maximize a view: Rerun draws none behind another tab. Its panels go, so that it has the window."""
    layout = viewer.get_blueprint().blueprint
    layout["/viewport"]["ViewportBlueprint"]["maximized"] = view_id
    for panel, kind in PANELS.items():
        layout.setdefault(f"/{panel}", {}).setdefault(kind, {})["state"] = "Hidden"
    viewer.set_blueprint(layout, of="recording")


def _settled(viewer: Any, process: Process, view_id: str | None, deadline: float) -> bytes | None:
    """A picture equal to the one before, and not of one colour; None: a view that stays empty."""
    quiet, last, given_up = float("inf"), None, time.monotonic() + EMPTY_SECONDS
    while True:
        try:
            picture: bytes = viewer.take_screenshot(view_id=view_id)
            pixels = _pixels(picture)
        except (ConnectionError, RuntimeError, OSError, TimeoutError) as error:
            _check(process, deadline, error)
            if view_id is not None:
                raise InputError(
                    "that view lies behind another tab of the layout, where Rerun does not draw it; leave --view out, "
                    "or bring the tab to the front in the viewer"
                ) from None
            continue
        same = last is not None and last.shape == pixels.shape and float((last != pixels).any(-1).mean()) < SETTLED
        if same and time.monotonic() > quiet and not is_blank(pixels) and not viewer.get_state().loading:
            return picture
        if same and view_id is not None and is_blank(pixels) and time.monotonic() > given_up:
            return None
        if last is None:
            quiet = time.monotonic() + (QUIET_SECONDS if view_id is None else 0.0)
        last = pixels
        _check(process, deadline, "the picture is blank" if is_blank(pixels) else "the picture kept changing")
        time.sleep(0.3)


def is_blank(pixels: NDArray[np.uint8]) -> bool:
    """Whether nearly every pixel has one colour: an empty window."""
    colors = pixels.reshape(-1, 3).astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    return bool(np.unique(colors, return_counts=True)[1].max() > 0.999 * len(colors))


def _pixels(png: bytes) -> NDArray[np.uint8]:
    return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)
