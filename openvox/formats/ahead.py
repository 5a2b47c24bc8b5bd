"""Reading ahead: the next items are made by a thread while the last one is used."""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

T = TypeVar("T")


def read_ahead(items: Iterable[T], ahead: int) -> Generator[T, None, None]:
    """The same items, made by a thread that is up to `ahead` of them further on; 0: no thread.

    An exception of the items is raised here. The thread has ended when this iterator is exhausted or closed."""
    iterator = iter(items)
    if ahead < 1:
        yield from iterator
        return
    done: queue.Queue[T | _End] = queue.Queue(maxsize=ahead)
    stop = threading.Event()
    thread = threading.Thread(target=_fill, args=(iterator, done, stop), name="openvox read ahead", daemon=True)
    thread.start()
    try:
        while not isinstance(item := done.get(), _End):
            yield item
        if item.error is not None:
            raise item.error
    finally:
        stop.set()
        while not done.empty():  # makes room for the one item that the thread may be waiting to put
            done.get()
        thread.join()


@dataclass(frozen=True, slots=True)
class _End:
    """What the thread puts last: the error that ended the items, if any."""

    error: BaseException | None


def _fill(items: Iterator[T], done: queue.Queue[T | _End], stop: threading.Event) -> None:
    error: BaseException | None = None
    try:
        for item in items:
            done.put(item)
            if stop.is_set():
                return
    except BaseException as raised:
        error = raised
    finally:
        if isinstance(items, Generator):
            items.close()
    done.put(_End(error))
