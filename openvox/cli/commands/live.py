"""`openvox live`: the map while the frames come."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from openvox.cli import options, tables
from openvox.cli.commands.replay import print_result as print_replay

if TYPE_CHECKING:
    from openvox.apps.living.gauge import Status

EXAMPLES = (
    "openvox live living.mcap --rate 2 --out robot",
    "openvox live robot.mcap.partial --follow --frontend geometry",
    "openvox live ws://127.0.0.1:8765 --out robot",
)
REDRAW_SECONDS = 0.2
SAY_SECONDS = 5.0


def live(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="A recording to play or follow, or a Foxglove server: ws://HOST:PORT."),
    ],
    rate: Annotated[float, typer.Option(metavar="R", help="Times the recording's own pace.")] = 1.0,
    follow: Annotated[bool, typer.Option("--follow", help="The recording is still being written.")] = False,
    perception: Annotated[Path | None, typer.Option(metavar="FILE", help="Instead of STEM.perception.mcap.")] = None,
    frontend: Annotated[
        Literal["offline", "geometry"] | None,
        typer.Option(help="Look at every frame now; offline, too, where there is no perception of the recording."),
    ] = None,
    preset: Annotated[Literal["openvox", "official", "paper"], typer.Option(help="As replay's.")] = "openvox",
    params: options.Params = None,
    assignments: options.Assignments = None,
    engine: options.Engine = "cpu",
    out: Annotated[
        str | None, typer.Option(metavar="STEM", help="Write STEM.mcap, STEM.map.npz, ... instead of STEM-live.")
    ] = None,
    max_memory: options.MaxMemory = None,
    waiting: Annotated[
        int | None,
        typer.Option(
            metavar="N", min=1, max=1000, help="Frames that may wait (4; 1 with --frontend); older are skipped."
        ),
    ] = None,
    port: Annotated[
        int, typer.Option(metavar="PORT", min=0, max=65535, help="Answer query --live there, on 127.0.0.1; 0 = any.")
    ] = 0,
    topics: Annotated[
        list[str] | None,
        typer.Option("--topic", metavar="ROLE=NAME", help="Server: color, depth, color_info, depth_info, pose."),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(metavar="FRAME", help="Server: the frame to map in; map, odom or world if it is there."),
    ] = None,
    camera: Annotated[str | None, typer.Option(metavar="FRAME", help="Server: the frame whose pose is wanted.")] = None,
    rerun: Annotated[Path | None, typer.Option(metavar="FILE.rrd", help="Also write a file for Rerun.")] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="URL", help="Show it in a Rerun viewer, as rerun+http://127.0.0.1:9876/proxy.")
    ] = None,
    spawn: Annotated[bool, typer.Option("--spawn", help="Open a Rerun viewer, and show it there.")] = False,
    publish: Annotated[
        int | None,
        typer.Option(metavar="PORT", min=0, max=65535, help="Boxes, captions, changed voxels for Foxglove; 0 = any."),
    ] = None,
    start: options.Start = None,
    end: options.End = None,
    stride: options.Stride = 1,
    json: options.Json = False,
) -> None:
    """Map a stream while it comes, and record all of it.

    Where the mapper is behind, the oldest waiting frames are recorded but not mapped, and replay of the recording
    skips the same: it gives the same map. Ctrl-C ends the run well; after a crash, replay takes STEM.mcap.partial.
    """
    from openvox.apps import live as application

    with ended_well() as stop:
        result = application.live(
            source,
            rate=rate,
            follow=follow,
            perception=perception,
            frontend=frontend,
            preset_name=preset,
            params=params,
            assignments=assignments or [],
            engine=engine,
            out=out,
            max_memory=max_memory,
            rerun=rerun,
            connect=connect,
            spawn=spawn,
            publish=publish,
            start=start,
            end=end,
            stride=stride,
            waiting=waiting,
            port=port,
            world=world,
            camera=camera,
            topics=options.pairs("--topic", topics or []),
            stop=stop,
            status=shown_status(),
            ready=lambda address: typer.echo(f'ask it: openvox query --live {address} "a chair"', err=True),
            notice=lambda text: typer.echo(text, err=True),
        )
    tables.show(result, json, print_result, "openvox", "replay", result["outputs"]["recording"], "--out", "again")


@contextmanager
def ended_well() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C, or a polite request of the system, sets; the second one ends the run at once."""
    stop = threading.Event()

    def handle(number: int, stack: object) -> None:
        stop.set()
        signal.signal(number, signal.default_int_handler)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def shown_status() -> Callable[[Status], None]:
    """One line on stderr: redrawn where a person watches, else a new one every few seconds."""
    terminal = sys.stderr.isatty()
    last = time.monotonic()

    def show(status: Status) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < (REDRAW_SECONDS if terminal else SAY_SECONDS):
            return
        last = now
        start, end = ("\r\x1b[K", "") if terminal else ("", "\n")
        print(f"{start}{status_line(status)}", end=end, file=sys.stderr, flush=True)

    return show


def status_line(status: Status) -> str:
    """As in `live  120 frames  117 mapped  3 dropped  latency 24 ms  30113 voxels`."""
    return (
        f"live  {status.frames} frames  {status.mapped} mapped  {status.dropped} dropped  "
        f"latency {status.latency_ms:.0f} ms  {status.voxels} voxels"
    )


def print_result(data: tables.Data) -> None:
    """As replay's, and how late the map was."""
    late = data["latency_ms"]
    print(
        f"{data['dropped']} frames were dropped (recorded, not mapped); latency mean {late['mean']:.0f} ms, median "
        f"{late['median']:.0f} ms, p95 {late['p95']:.0f} ms"
    )
    print_replay({**data, "passes": []})
