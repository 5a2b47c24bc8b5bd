"""One item in a process of its own: what dies there is an item that failed, whoever asked for it.

A process of Dask's may start none by multiprocessing, so this is a fresh interpreter that is told over its standard
input what to do. It ends with the process that asked: a task that Dask gives to another worker must not be done twice
at a time."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from openvox.apps.sweeping.pool import Answer, answered, death

MODULE = "openvox.apps.sweeping.alone"


def alone(function: Callable[[Any], Any], task: Any) -> Answer:
    """Result and error of function(task), both of which a fresh process can import."""
    watched, held = os.pipe()
    try:
        done = subprocess.run(
            [sys.executable, "-m", MODULE, str(watched)],
            input=pickle.dumps((function, task)),
            stdout=subprocess.PIPE,
            pass_fds=(watched,),
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            check=False,
        )
    finally:
        os.close(watched)
        os.close(held)
    if done.returncode:
        return None, death(done.returncode)
    answer: Answer = pickle.loads(done.stdout)
    return answer


def _main() -> None:
    threading.Thread(target=_end_with, args=(int(sys.argv[1]),), daemon=True).start()
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not stand in the answer
    function, task = pickle.load(sys.stdin.buffer)
    with out:
        out.write(pickle.dumps(answered(function, task)))


def _end_with(watched: int) -> None:
    """Ends this process when the other end of a pipe is gone, which its parent held."""
    os.read(watched, 1)
    os._exit(1)


if __name__ == "__main__":
    _main()
