"""What is in an .rrd file of Rerun, read without a viewer."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError

AGAIN = "make it again with --rerun or openvox view --save"
LARGEST = 8
"""So many entities are told with their sizes."""


def rrd_info(path: Path) -> dict[str, Any]:
    """`application`, `recording_ids`, `timelines` (name to first and last: frames, or ns), `entities`, `rows`, `bytes`
    of the file, `unpacked_bytes` of what was logged, and `largest`, the entities that take most of these.

    Raises InputError where the file is not whole."""
    import pyarrow.compute as pc

    timelines: dict[str, list[int]] = {}
    size: Counter[str] = Counter()
    rows = 0
    with _reader(path) as reader:
        stores = reader.recordings()
        for chunk in reader.stream():
            batch = chunk.to_record_batch()
            size[str(chunk.entity_path)] += batch.nbytes
            rows += chunk.num_rows
            for name in chunk.timeline_names:
                found = pc.min_max(batch.column(name).cast("int64")).as_py()
                if found["min"] is not None:  # else the chunk has no row
                    first, last = timelines.get(name, found.values())
                    timelines[name] = [min(first, found["min"]), max(last, found["max"])]
    return {
        "application": ", ".join(sorted({store.application_id for store in stores})),
        "recording_ids": [store.recording_id for store in stores],
        "timelines": {name: timelines[name] for name in sorted(timelines)},
        "entities": len(size),
        "rows": rows,
        "bytes": path.stat().st_size,
        "unpacked_bytes": size.total(),
        "largest": dict(sorted(size.items(), key=lambda one: (-one[1], one[0]))[:LARGEST]),
    }


def check_readable(path: Path) -> None:
    """Raises InputError where the file is cut off, damaged or empty: the viewer would show nothing, and not say why."""
    with _reader(path) as reader:
        if not reader.recordings():
            raise InputError(f"{path} holds nothing that was logged; {AGAIN}")


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    from rerun.chunk import RrdReader

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a cut file has no footer, which is told below
            yield RrdReader(str(path))
    except (RuntimeError, ValueError, OSError) as error:
        reason = str(error).rpartition(": ")[2]
        raise InputError(f"{path} is cut off or damaged ({reason}); {AGAIN}") from None
