"""MCAP files of any robot in Foxglove's schemas; ROS 2 messages (CDR) may be among them."""

from __future__ import annotations

from pathlib import Path

from openvox.core.errors import InputError
from openvox.formats.foxglove_log import KINDS, foxglove_topics, messages
from openvox.formats.robot_log import Log, TopicKind
from openvox.sources import log_frames, ros
from openvox.sources.source import Options, Source

WANTED = ("*.mcap",)


def missing(path: Path, options: Options) -> list[str]:
    """What is missing for it to be such a file."""
    return [] if path.suffix == ".mcap" and path.is_file() else ["a .mcap file"]


def read(path: Path, options: Options) -> Source:
    """Opens a file. Raises InputError, also while iterating."""
    kinds: dict[str, TopicKind] = {}
    for topic, (schema, encoding) in sorted(foxglove_topics(path).items()):
        if topic.startswith("/truth/"):
            raise InputError(f"{path} seems to be a recording of openvox already; go on with openvox perceive {path}")
        known = KINDS if encoding == "protobuf" else ros.KINDS if encoding == "cdr" else {}
        if schema in known:
            kinds[topic] = known[schema]
    log = Log(path, "foxglove", kinds, lambda names: messages(path, names, ros.cdr_item))
    return log_frames.read(log, options)
