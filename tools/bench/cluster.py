"""A sweep here and on a Dask cluster of this machine: wall times, and what Dask itself costs.

    .venv/bin/python tools/bench/cluster.py living.mcap [--end 60]

Both with one and with two items at a time. The first run of each kind is not counted; results are thrown away.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from distributed import LocalCluster

from openvox.apps.sweep import sweep
from openvox.apps.sweeping.alone import alone
from openvox.apps.sweeping.cluster import cluster

SETS = ["association.threshold=0.2,0.3,0.4,0.5"]
TASKS, MANY = 20, 500


@contextmanager
def workers(number: int) -> Iterator[str]:
    """Address of a scheduler on loopback with so many workers of one thread."""
    with LocalCluster(
        n_workers=number,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
        memory_limit=0,
        silence_logs="CRITICAL",
    ) as here:
        yield here.scheduler_address


def seconds_of(recording: Path, end: int, **how: Any) -> float:
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        found = sweep([recording], assignments=SETS, out=Path(folder) / "out", end=end, **how)
        assert found["failed"] == 0, found["items"]
        return time.perf_counter() - began


def sweeps(recording: Path, end: int) -> None:
    seconds_of(recording, 2, jobs=1)
    for number in (1, 2):
        here = seconds_of(recording, end, jobs=number)
        with workers(number) as address:
            seconds_of(recording, 2, dask=address)
            there = seconds_of(recording, end, dask=address)
        print(f"{number} at a time: {here:.1f} s here, {there:.1f} s on Dask, {there / here:.2f} times", flush=True)


def overhead() -> None:
    """Of a task that does nothing: through Dask alone, and in a fresh process, which is what an item costs besides."""
    tasks = [*range(TASKS)]
    began = time.perf_counter()
    assert [alone(abs, task)[0] for task in tasks] == tasks
    fresh = (time.perf_counter() - began) / TASKS
    with workers(1) as address:
        began = time.perf_counter()
        with cluster(address) as found:
            connected = time.perf_counter() - began
            began = time.perf_counter()
            numbers = [found.client.submit(abs, number, pure=False) for number in range(MANY)]
            assert sum(number.result() for number in numbers) == sum(range(MANY))
            through = (time.perf_counter() - began) / MANY
    print(
        f"connecting {connected:.2f} s; a task costs {1000 * through:.1f} ms in Dask, {1000 * fresh:.0f} ms a process"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--end", type=int, default=60)
    given = parser.parse_args()
    overhead()
    sweeps(given.recording, given.end)
