"""The Rerun viewer as a process of its own: on the screen, in a browser, or without either. It listens on one address,
the loopback unless told otherwise; Rerun's own default is every interface."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import quote, urlsplit

from openvox.core.errors import InputError

LOOPBACK = "127.0.0.1"
PATIENCE = 30.0
"""Seconds in which a server must answer."""
PR_SET_PDEATHSIG = 1
Process = subprocess.Popen[bytes]


def binary() -> Path:
    """The viewer itself; the script of that name in PATH is a wrapper that leaves it behind when it ends."""
    import rerun_cli

    path = Path(str(rerun_cli.__file__)).parent / ("rerun.exe" if sys.platform == "win32" else "rerun")
    if not path.exists():
        raise InputError(f"the Rerun viewer is not where rerun-sdk puts it ({path}); install rerun-sdk anew")
    return path


@contextmanager
def running(arguments: Sequence[str | Path]) -> Iterator[Process]:
    """The viewer while the block lasts; it is ended with the block, whatever happens."""
    quiet = {**os.environ, "RUST_LOG": "error"}
    command = [str(binary()), *map(str, arguments)]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=quiet, preexec_fn=_end_with_parent()
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _end_with_parent() -> Callable[[], object] | None:
    """On Linux: have the kernel end the viewer when this process dies, however that comes."""
    if sys.platform != "linux":
        return None
    prctl = ctypes.CDLL(None).prctl  # found here: between fork and exec nothing should be loaded
    return lambda: prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def open_window(files: Sequence[Path]) -> None:
    """Show files on the screen until the window is closed or Ctrl-C. Raises InputError where there is no screen."""
    if not has_screen():
        raise InputError(
            "there is no screen here; use --web for a browser, --save OUT.rrd for a file, or openvox shot for a picture"
        )
    with running(["--bind", LOOPBACK, "--port", "auto", *files]) as process:
        try:
            code = process.wait()
        except KeyboardInterrupt:
            return
    if code:
        raise InputError("the Rerun viewer could not open a window; use --web, or --save OUT.rrd for another machine")


@contextmanager
def window() -> Iterator[str]:
    """A window that waits for a run; yields its URL. After the block it stays until it is closed, or Ctrl-C.

    Raises InputError where there is no screen."""
    if not has_screen():
        raise InputError("there is no screen here; use --connect URL for a viewer elsewhere, or --rerun FILE.rrd")
    port = free_port(LOOPBACK)
    with running(["--bind", LOOPBACK, "--port", str(port)]) as process:
        _wait_for(process, LOOPBACK, port)
        yield f"rerun+http://{LOOPBACK}:{port}/proxy"
        with suppress(KeyboardInterrupt):
            process.wait()


def has_screen() -> bool:
    """True unless this is a Unix without X or Wayland."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def serve_web(files: Sequence[Path], bind: str, port: int, ready: Callable[[str], None]) -> None:
    """Serve files to browsers until Ctrl-C, on one address only. port: of the page, 0 = any that is free.

    ready: told the page's URL once it answers. Raises InputError: the address or port cannot be had."""
    page, data = free_port(bind, port), free_port(bind)
    arguments = ["--serve-web", "--bind", bind, "--port", str(data), "--web-viewer-port", str(page)]
    with running([*arguments, "--server-memory-limit", "50%", *files]) as process:
        try:
            for needed in (page, data):
                _wait_for(process, bind, needed)
            source = quote(f"rerun+http://{_in_url(bind)}:{data}/proxy", safe="")
            ready(f"http://{_in_url(bind)}:{page}/?url={source}")
            process.wait()
        except KeyboardInterrupt:
            return
    raise InputError("Rerun's server ended by itself; is there enough memory?")


def check_url(url: str) -> None:
    """Raises InputError unless a viewer listens where `url` says, as in rerun+http://127.0.0.1:9876/proxy."""
    parts = urlsplit(url)
    try:
        if parts.scheme not in ("rerun+http", "rerun+https") or not parts.hostname or not parts.port:
            raise ValueError("expected rerun+http://HOST:PORT/proxy")
        socket.create_connection((parts.hostname, parts.port), timeout=PATIENCE).close()
    except (OSError, ValueError) as error:
        raise InputError(f"no Rerun viewer can be reached at {url} ({error}); start one with: rerun") from None


def free_port(bind: str, port: int = 0) -> int:
    """The port if it can be had on that address, any free one for 0. Raises InputError."""
    try:
        with socket.socket(socket.AF_INET6 if ":" in bind else socket.AF_INET) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((bind, port))
            return int(probe.getsockname()[1])
    except OSError as error:
        raise InputError(
            f"port {port} of {bind} cannot be had ({error.strerror or error}); "
            "choose another --port (0 = any) or --bind"
        ) from None


def _wait_for(process: Process, bind: str, port: int) -> None:
    begin = time.monotonic()
    while True:
        try:
            socket.create_connection((bind, port), timeout=1).close()
            return
        except OSError:
            if process.poll() is not None or time.monotonic() - begin > PATIENCE:
                raise InputError(
                    f"Rerun's server did not begin to listen on {bind} port {port}; choose another --port"
                ) from None
        time.sleep(0.05)


def _in_url(bind: str) -> str:
    return f"[{bind}]" if ":" in bind else bind
