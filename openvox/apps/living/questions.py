"""Questions to a map that grows: one JSON object a line over a socket, {"texts": [...], "top": 3} and its answer."""

from __future__ import annotations

import json
import socket
import socketserver
import threading
from collections.abc import Callable, Sequence
from typing import Any

from openvox.core.errors import InputError

LOOPBACK = "127.0.0.1"
MAX_QUESTION = 1 << 16
MAX_ANSWER = 1 << 26
PATIENCE = 60.0
"""Seconds in which the other side must have spoken."""
Answer = Callable[[Sequence[str], int], dict[str, Any]]


class Questions:
    """Listens on the loopback while the block lasts; every question is answered in a thread of its own.

    port: 0 = any that is free. Raises InputError where it cannot be had."""

    def __init__(self, answer: Answer, port: int = 0) -> None:
        class Handler(socketserver.StreamRequestHandler):
            timeout = PATIENCE

            def handle(self) -> None:
                try:
                    self.wfile.write(json.dumps(_answered(self.rfile.readline(MAX_QUESTION), answer)).encode() + b"\n")
                except OSError:  # the one who asked is gone
                    return

        try:
            self._server = _Server((LOOPBACK, port), Handler)
        except OSError as error:
            raise InputError(f"port {port} of {LOOPBACK} cannot be had ({error.strerror}); choose another") from None
        self._thread = threading.Thread(target=self._server.serve_forever, name="openvox questions", daemon=True)

    @property
    def address(self) -> str:
        """HOST:PORT."""
        host, port = self._server.server_address[:2]
        return f"{host!s}:{port}"

    def __enter__(self) -> str:
        self._thread.start()
        return self.address

    def __exit__(self, *error: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True


def _answered(line: bytes, answer: Answer) -> dict[str, Any]:
    try:
        question = json.loads(line)
        texts, top = question["texts"], question["top"]
        if not (isinstance(top, int) and isinstance(texts, list) and all(isinstance(text, str) for text in texts)):
            raise TypeError
    except (ValueError, KeyError, TypeError, RecursionError):
        return {"error": 'expected one line like {"texts": ["a chair"], "top": 3}'}
    try:
        return answer(texts, top)
    except InputError as error:
        return {"error": str(error)}


def ask(address: str, texts: Sequence[str], top: int) -> dict[str, Any]:
    """The answer of the live run that listens at HOST:PORT. Raises InputError."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise InputError(f"{address} is no address; expected HOST:PORT, as openvox live prints it")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=PATIENCE) as connection:
            connection.sendall(json.dumps({"texts": list(texts), "top": top}).encode() + b"\n")
            with connection.makefile("rb") as lines:
                line = lines.readline(MAX_ANSWER)
        found = json.loads(line)
    except (OSError, ValueError) as error:
        raise InputError(f"no live run answers at {address} ({error}); is openvox live still running?") from None
    if not isinstance(found, dict) or "error" in found or "queries" not in found:
        what = found.get("error", "something else") if isinstance(found, dict) else "something else"
        raise InputError(f"the live run at {address} answered: {what}")
    return found
