"""Many items side by side in processes of their own: one that fails or dies costs the item it was doing, no other."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from openvox.core.errors import OpenvoxError

Task = TypeVar("Task")
Result = TypeVar("Result")
Answer = tuple[Any, str | None]
"""What came of a task, and a sentence if it failed."""
PATIENCE = 5.0
"""Seconds that a process has to end by itself."""


@dataclass(frozen=True, slots=True)
class Outcome(Generic[Result]):
    """What became of a task."""

    place: int
    """In the list of tasks."""
    result: Result | None
    error: str | None
    """A sentence if it failed."""


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    pipe: Connection
    place: int
    """Of the task that it is doing."""


def in_processes(function: Callable[[Task], Result], tasks: Sequence[Task], jobs: int) -> Iterator[Outcome[Result]]:
    """Every task's outcome, as they come. function and tasks travel to fresh processes, which serve one after another.

    A process that has died is replaced, and its task has failed."""
    waiting = list(range(len(tasks)))[::-1]
    workers: list[_Worker] = []
    try:
        while waiting or workers:
            while waiting and len(workers) < jobs:
                workers.append(_started(function, tasks, waiting.pop()))
            ready = wait([worker.pipe for worker in workers])
            for worker in [worker for worker in workers if worker.pipe in ready]:
                answer = _answer(worker)
                yield Outcome(worker.place, *answer[:2])
                if answer[2] and waiting:
                    worker.place = waiting.pop()
                    worker.pipe.send(tasks[worker.place])
                else:
                    workers.remove(worker)
                    _end(worker)
    finally:
        for worker in workers:
            worker.process.terminate()
            _end(worker)


def _started(function: Callable[[Task], Result], tasks: Sequence[Task], place: int) -> _Worker:
    context = multiprocessing.get_context("spawn")  # nothing of this process travels along: same work everywhere
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(function, there), daemon=True)
    process.start()
    there.close()  # so that its death is the end of the pipe
    here.send(tasks[place])
    return _Worker(process, here, place)


def _answer(worker: _Worker) -> tuple[Any, str | None, bool]:
    """Result, error, and whether the process goes on."""
    try:
        result, error = worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join(PATIENCE)
        return None, death(worker.process.exitcode), False
    return result, error, True


def death(code: int | None) -> str:
    """The sentence of a task whose process ended before it answered."""
    how = f"signal {-code}" if code is not None and code < 0 else f"exit code {code}"
    return f"its process died ({how}); if the memory was short, do fewer at a time"


def answered(function: Callable[[Any], Any], task: Any) -> Answer:
    """The function's result, or what went wrong, in words."""
    try:
        return function(task), None
    except OpenvoxError as error:
        return None, str(error)
    except Exception as error:
        return None, f"a fault of openvox itself ({type(error).__name__}: {error})"


def _end(worker: _Worker) -> None:
    worker.pipe.close()
    worker.process.join(PATIENCE)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()


def _end_with_parent() -> None:
    """Of a parent that was killed nobody wants the rest, and the next run writes the same files."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _serve(function: Callable[[Any], Any], pipe: Connection) -> None:
    """In the process: do what comes until the pipe ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends this process
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            task = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(answered(function, task))
