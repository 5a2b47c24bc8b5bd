"""Many items on a Dask cluster: the same functions as in processes of this machine, one item a process there, too."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from openvox import __version__
from openvox.apps.sweeping.alone import alone
from openvox.apps.sweeping.pool import Outcome
from openvox.core.errors import InputError

Task = TypeVar("Task")
Result = TypeVar("Result")
PATIENCE = 10
"""Seconds that a scheduler, and then its first worker, has to answer."""


@dataclass(frozen=True)
class Cluster:
    """A connection to a scheduler that has workers with this version of openvox."""

    client: Any
    threads: int
    """Items that it does at a time."""

    def each(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Outcome[Result]]:
        """Every task's outcome, as they come. function and tasks travel; an item whose process dies has failed.

        An outcome is fetched and let go at once: a worker that is lost later takes nothing finished along."""
        from distributed import as_completed

        futures = [self.client.submit(alone, function, task, pure=False, retries=0) for task in tasks]
        place = {future.key: number for number, future in enumerate(futures)}
        try:
            for future in as_completed(futures, loop=self.client.loop):
                if future.status == "finished":
                    yield Outcome(place[future.key], *future.result())
                else:
                    yield Outcome(place[future.key], None, _lost(future))
                futures[place[future.key]] = None
                future.release()
        finally:
            self.client.cancel([future for future in futures if future is not None])


@contextmanager
def cluster(address: str) -> Iterator[Cluster]:
    """The cluster of the scheduler at an address, as tcp://127.0.0.1:8786. Raises InputError: the extra is absent,
    nobody answers, or the workers have another openvox."""
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            '--dask needs an extra that is not installed: pip install "openvox[cluster]", here and on the workers'
        ) from None
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(
            f"--dask {address}: no scheduler answers there ({reason}); start one with dask scheduler, and name it as "
            "tcp://HOST:PORT"
        ) from None
    try:
        yield Cluster(client, _checked(client, address))
    finally:
        client.close()


def _checked(client: Any, address: str) -> int:
    """Threads of all workers, which have this version. Raises InputError."""
    try:
        client.wait_for_workers(1, timeout=PATIENCE)
    except TimeoutError:
        raise InputError(f"--dask {address}: no worker is there; start some with dask worker {address}") from None
    for worker, version in sorted(client.run(_version, on_error="return").items()):
        if version != __version__:
            found = f"openvox {version}" if isinstance(version, str) else f"no openvox ({version})"
            raise InputError(f"--dask {address}: worker {worker} has {found}; expected {__version__} on every one")
    return sum(client.nthreads().values())


def _version() -> str:
    from openvox import __version__ as version

    return version


def _lost(future: Any) -> str:
    """Why there is no answer: the worker itself died, or the function could not travel."""
    error = future.exception() if future.status == "error" else future.status
    return f"Dask could not run it ({type(error).__name__}: {error})"
