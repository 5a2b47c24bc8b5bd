"""The command line: it parses, calls one function, prints. The only place that turns errors into sentences."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Sequence
from typing import NoReturn

from openvox.core.errors import OpenvoxError

INTERRUPTED = 130
LEFT = {
    **dict.fromkeys(("perceive", "sweep"), "; what is done is kept; run again to go on"),
    **dict.fromkeys(("replay", "report", "shot", "view"), "; nothing was written"),
}
"""What an interrupt leaves; of other commands it depends."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run one command and exit: 0 done, 1 a sentence on stderr, 2 wrong usage, 130 interrupted.

    `--debug` may stand anywhere among the arguments and lets the traceback of an error through.
    """
    from openvox.cli.commands import app

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: children and temporary files go
    os.environ.setdefault("RUST_LOG", "error")  # what Rerun remarks besides is no sentence for users
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        app([word for word in words if word != "--debug"], prog_name="openvox")
    except SystemExit as end:
        if end.code == INTERRUPTED:
            _say_interrupted(words)
        if isinstance(end.__context__, BrokenPipeError):  # as _flush, met while printing
            _drop_stdout()
            sys.exit(0)
        _flush()
        sys.exit(end.code)
    except Exception as error:
        if _is_interrupt(error):
            _say_interrupted(words)
            sys.exit(INTERRUPTED)
        if "--debug" in words:
            raise
        print(f"openvox: {_sentence(error)}", file=sys.stderr)
        sys.exit(1)
    sys.exit(0)


def _is_interrupt(error: BaseException | None) -> bool:
    """Ctrl-C inside a compiled kernel arrives as the cause of another error."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _flush() -> None:
    """Empty stdout now: a reader that has gone (`openvox info x | head -1`) is no error of ours."""
    if sys.stdout is None:  # closed by the caller (`openvox info x >&-`)
        return
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()


def _drop_stdout() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _say_interrupted(words: Sequence[str]) -> None:
    command = next((word for word in words if not word.startswith("-")), "")
    print(f"openvox: interrupted{LEFT.get(command, '')}", file=sys.stderr)


def _sentence(error: Exception) -> str:
    if isinstance(error, OpenvoxError):
        return str(error)
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'the system'}: {error.strerror}"
    return f"a fault of openvox itself ({type(error).__name__}: {error}); please report it with what --debug shows"
