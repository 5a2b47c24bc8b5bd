"""Rerun files that are no run of the mapper: what is logged in one go, with a layout of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from openvox.core.errors import OutputError
from openvox.formats.atomic import partial_file
from openvox.view import entities

END_OF_FILE = b"RRF2FOOT"
"""Near the end of every file that was closed."""


@contextmanager
def rrd_file(
    path: Path, application: str, layout: rrb.Blueprint, roots: Sequence[str] = (entities.WORLD,)
) -> Iterator[rr.RecordingStream]:
    """Yields a stream whose file appears when the block ends well. Raises OutputError.

    application: the viewer keeps one layout for all files of one application. roots: entities whose z is up."""
    stream = rr.RecordingStream(application, send_properties=False)
    with partial_file(path) as partial:
        try:
            stream.save(partial, default_blueprint=layout)
            stream.set_log_time_enabled(False)
            stream.set_log_tick_enabled(False)
            stream.send_recording_name(path.stem)
            for root in roots:
                stream.log(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            yield stream
            stream.flush()
        except RuntimeError as error:  # what Rerun makes of the system's refusal
            raise OutputError(
                f"{path} could not be written (Rerun's writer stopped: {error}); nothing was left"
            ) from error
        finally:
            stream.disconnect()
        check_whole(partial)


def check_whole(path: Path) -> None:
    """Rerun writes in a thread of its own, and tells nobody when the disk is full. Raises OSError."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 64))
        if END_OF_FILE not in file.read():
            raise OSError("Rerun did not write it to its end; is the disk full?")
