"""A Foxglove WebSocket server, as the bridge from ROS has one: frames as they come.

The first seconds are kept and looked at, as those of a log, to choose the camera's topics and the frames of reference;
then they are read again, and everything behind them. What openvox does not read is not asked for.
"""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from openvox.core.errors import InputError
from openvox.formats.foxglove_log import KINDS, item
from openvox.formats.mcap_io import MAX_RECORD
from openvox.formats.robot_log import Item, Log, TopicKind
from openvox.sources import log_frames, ros
from openvox.sources.source import Options, Source

PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
PATIENCE = 10.0
"""Seconds in which a server must answer and show a camera."""
ENOUGH = 2.0
"""Seconds of messages that are looked at before anything is chosen."""
POLL = 0.1
MESSAGE = struct.Struct("<BIQ")
MESSAGE_DATA = 1
Received = tuple[int, str, Item]


@dataclass(frozen=True, slots=True)
class Channel:
    """What a server offers."""

    number: int
    topic: str
    kind: TopicKind
    decode: Callable[[bytes], Item]


def read(url: str, options: Options, stop: threading.Event) -> Source:
    """Connects and looks at what comes; `stop` ends the frames. Raises InputError, also while iterating."""
    stream = _Stream(url, stop)
    try:
        stream.look_at()
        source = log_frames.read(Log(url, "foxglove-websocket", stream.topics, stream.read), options)
    except BaseException:
        stream.close()
        raise
    stream.probing = False
    return source


class _Stream:
    """A connection; its first messages can be read again."""

    def __init__(self, url: str, stop: threading.Event) -> None:
        self.url, self._stop = url, stop
        self.probing = True
        self._channels: dict[int, Channel] = {}  # by the number of our subscription
        self._head: list[Received] = []
        self._leaving = ExitStack()
        self._connection = self._leaving.enter_context(self._connected())

    @property
    def topics(self) -> Mapping[str, TopicKind]:
        """Those that are read."""
        return {channel.topic: channel.kind for channel in sorted(self._channels.values(), key=lambda one: one.topic)}

    def look_at(self) -> None:
        """Receive until there was a picture and a calibration, and ENOUGH seconds more."""
        begin = time.monotonic()
        seen: float | None = None
        while not self._stop.is_set():
            now = time.monotonic()
            if seen is not None and now - seen > ENOUGH:
                return
            if now - begin > PATIENCE:
                break
            received = self._receive(POLL)
            if received is not None:
                self._head.append(received)
                kinds = {self.topics[topic] for _, topic, _ in self._head[-1:]}
                seen = seen if seen is not None or "image" not in kinds else now
        if seen is None:
            raise InputError(
                f"{self.url} sent no picture within {PATIENCE:.0f} s (topics that openvox reads: "
                f"{', '.join(self.topics) or 'none'}); is the camera on?"
            )

    def read(self, topics: Collection[str]) -> Iterator[Received]:
        """The first messages of some topics and, once all was chosen, those that come until the server goes."""
        yield from (one for one in self._head if one[1] in topics)
        if self.probing:
            return
        self._head.clear()
        self._leave({number for number, channel in self._channels.items() if channel.topic not in topics})
        try:
            while not self._stop.is_set():
                received = self._receive(POLL)
                if received is not None and received[1] in topics:
                    yield received
        except _GoneError:
            return
        finally:
            self.close()

    def close(self) -> None:
        """Leave the server."""
        self._leaving.close()

    @contextmanager
    def _connected(self) -> Iterator[Any]:
        try:
            from websockets.sync.client import connect
        except ImportError:
            raise InputError(
                f'{self.url}: to read a Foxglove server, install the extra "live": pip install "openvox[live]"'
            ) from None
        with ExitStack() as stack:
            try:
                opened = connect(
                    self.url, subprotocols=PROTOCOLS, max_size=MAX_RECORD, open_timeout=PATIENCE, proxy=None
                )
                connection = stack.enter_context(opened)
            except Exception as error:  # the library's, the system's, or one of the address
                text = " ".join(str(error).split()) or type(error).__name__
                raise InputError(f"{self.url} cannot be reached as a Foxglove WebSocket server ({text:.200})") from None
            yield connection

    def _receive(self, seconds: float) -> Received | None:
        """The next message that is read; None if none came. Raises _GoneError."""
        from websockets.exceptions import ConnectionClosed

        try:
            data = self._connection.recv(timeout=seconds)
        except TimeoutError:
            return None
        except ConnectionClosed:
            if self.probing:
                raise InputError(f"{self.url} closed the connection before it sent a camera's pictures") from None
            raise _GoneError from None
        if isinstance(data, str):
            self._hear(data)
            return None
        return self._message(data)

    def _hear(self, text: str) -> None:
        """Subscribe to what is offered and can be read, while all is still to be chosen."""
        try:
            said = json.loads(text)
            offered = said.get("channels", []) if said.get("op") == "advertise" and self.probing else []
            channels = [found for one in offered if (found := _channel(one)) is not None]
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise InputError(f"{self.url} says what no Foxglove server says ({error!r})") from None
        wanted = []
        for channel in channels:
            number = len(self._channels)
            self._channels[number] = channel
            wanted.append({"id": number, "channelId": channel.number})
        if wanted:
            self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def _leave(self, numbers: set[int]) -> None:
        if numbers:
            self._connection.send(json.dumps({"op": "unsubscribe", "subscriptionIds": sorted(numbers)}))

    def _message(self, data: bytes) -> Received | None:
        if len(data) < MESSAGE.size or data[0] != MESSAGE_DATA:
            return None
        _, number, log_time = MESSAGE.unpack_from(data)
        channel = self._channels.get(number)
        if channel is None:
            return None
        try:
            return log_time, channel.topic, channel.decode(data[MESSAGE.size :])
        except InputError:
            raise
        except Exception as error:  # protobuf's, or the ROS library's of broken bytes
            raise InputError(f"{self.url}, {channel.topic}: a message cannot be read ({error})") from None


class _GoneError(Exception):
    """The server closed the connection."""


def _channel(offer: Mapping[str, Any]) -> Channel | None:
    """A channel that can be read; the truth that a recording of ours may come with is not looked at."""
    number, topic, schema, encoding = (offer[name] for name in ("id", "topic", "schemaName", "encoding"))
    if str(topic).startswith("/truth/"):
        return None
    if encoding == "protobuf" and schema in KINDS:
        return Channel(int(number), str(topic), KINDS[schema], lambda data: item(topic, schema, data))
    if encoding == "cdr" and schema in ros.KINDS:
        return Channel(int(number), str(topic), ros.KINDS[schema], lambda data: ros.cdr_item(topic, schema, data))
    return None
