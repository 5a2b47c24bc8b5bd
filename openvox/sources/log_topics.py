"""Which topics of a log are colour, depth and their calibrations: by type, encoding, size, frame and name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from openvox.core.errors import InputError
from openvox.formats.robot_log import Calibration, Item, Log, Picture, Transform
from openvox.sources.log_pictures import COLORS, is_depth, size_of

PROBE_NS = 10_000_000_000
"""Log time that is looked at before anything is decided."""
PROBE_MESSAGES = 20_000
_PACKED = re.compile(r"/(compressed|compressedDepth|ffmpeg|theora|zstd)$")
_OTHER_CAMERAS = re.compile(r"infra|fisheye|/ir[/_]|confidence|thermal", re.IGNORECASE)
ROLES = ("color", "depth", "color_info", "depth_info", "pose")


@dataclass(frozen=True, eq=False)
class Choice:
    """The topics of one RGB-D camera, with the first item of each."""

    depth: str
    depth_picture: Picture
    depth_info: Calibration
    color: str = ""
    """Empty where the log has no colour."""
    color_picture: Picture | None = None
    color_info: Calibration | None = None

    @property
    def registered(self) -> bool:
        """True if depth's topic says that it is seen from the colour camera, as drivers name it."""
        return any(word in self.depth for word in ("aligned", "registered", "depth_to_rgb", "depth_to_color"))

    @property
    def topics(self) -> set[str]:
        """Those of pictures."""
        return {self.depth, *filter(None, [self.color])}


@dataclass(frozen=True, eq=False)
class Probe:
    """The first item on each topic, and the transforms of the beginning; those that never move from the whole log."""

    first: Mapping[str, Item]
    transforms: tuple[tuple[str, Transform], ...]
    """Each with its topic."""


def probe(log: Log) -> Probe:
    """Looks into a log."""
    first: dict[str, Item] = {}
    transforms: list[tuple[str, Transform]] = []
    static = {topic for topic, kind in log.topics.items() if kind == "transforms" and "static" in topic}
    if static:
        transforms += [(topic, one) for _, topic, item in log.read(static) if isinstance(item, tuple) for one in item]
    wanted = {topic for topic in log.topics if topic not in static}
    begin: int | None = None
    for count, (time, topic, item) in enumerate(log.read(wanted)):
        begin = time if begin is None else begin
        if time - begin > PROBE_NS or count > PROBE_MESSAGES:
            break
        first.setdefault(topic, item)
        if isinstance(item, tuple):
            transforms += [(topic, one) for one in item]
    return Probe(first, tuple(transforms))


def choose(log: Log, found: Probe, given: Mapping[str, str]) -> Choice:
    """The camera's topics. Raises InputError where there is none, or more than one and nobody chose."""
    for role, topic in given.items():
        if role not in ROLES or topic not in log.topics:
            raise InputError(
                f"{log.path}: --topic {role}={topic}: "
                + (f"there is no topic {topic}; it has {_listed(log.topics)}" if role in ROLES else "")
                + ("" if role in ROLES else f"expected one of {', '.join(ROLES)}")
            )
    pictures = {topic: item for topic, item in found.first.items() if isinstance(item, Picture)}
    depths = _candidates(log, pictures, "depth", given)
    colors = _candidates(log, pictures, "color", given)
    if not depths:
        raise InputError(
            f"{log.path} has no depth pictures among its topics ({_listed(log.topics)}); openvox maps RGB-D"
        )
    if not colors:
        _check_encodings(log, pictures)
    pairs = [(color, depth) for depth in depths for color in colors or [""]]
    if len(pairs) > 1:
        aligned = [pair for pair in pairs if pair[0] and _aligned(pictures[pair[0]], pictures[pair[1]])]
        pairs = aligned if len(aligned) == 1 else pairs
    if len(pairs) > 1:
        raise InputError(
            f"{log.path} has several cameras: colour on {_listed(colors)}, depth on {_listed(depths)}; choose with "
            "--topic color=NAME --topic depth=NAME"
        )
    color, depth = pairs[0]
    infos = {topic: item for topic, item in found.first.items() if isinstance(item, Calibration)}
    color_info = None if not color else _info(log, color, pictures[color], infos, given.get("color_info"))
    depth_info = _info(log, depth, pictures[depth], infos, given.get("depth_info"))
    if color and color_info and depth_info is None and _aligned(pictures[color], pictures[depth]):
        depth_info = color_info
    for role, topic, info in (("color", color, color_info), ("depth", depth, depth_info)):
        if topic and info is None:
            raise InputError(
                f"{log.path}: no calibration belongs to {topic} (there are {_listed(infos)}); name it with "
                f"--topic {role}_info=NAME"
            )
    assert depth_info is not None
    return Choice(depth, pictures[depth], depth_info, color, pictures[color] if color else None, color_info)


def _check_encodings(log: Log, pictures: Mapping[str, Picture]) -> None:
    """Colour in an encoding that is not read must not pass for no colour."""
    for topic, picture in sorted(pictures.items()):
        if not _is_depth(topic, picture) and picture.encoding not in (*COLORS, "compressed"):
            raise InputError(
                f"{log.path}: {topic} is {picture.encoding!r}, which is not read; expected {', '.join(COLORS)} or a "
                "compressed topic (image_proc and image_transport republish make them)"
            )


def _candidates(log: Log, pictures: Mapping[str, Picture], role: str, given: Mapping[str, str]) -> list[str]:
    """Topics that can have the role, one of each picture's forms: colour as it was compressed, depth as it was not."""
    if role in given:
        if given[role] not in pictures:
            raise InputError(f"{log.path}: {given[role]} has no picture within its first seconds")
        return [given[role]]
    depth = role == "depth"
    fitting = [topic for topic in sorted(pictures) if _is_depth(topic, pictures[topic]) == depth]
    if not depth:
        fitting = [topic for topic in fitting if pictures[topic].encoding in (*COLORS, "compressed")]
        named = [topic for topic in fitting if not _OTHER_CAMERAS.search(topic)]
        colored = [topic for topic in named if pictures[topic].encoding not in ("mono8", "8UC1")]
        fitting = colored or named
    forms: dict[str, str] = {}
    for topic in fitting:
        base = _PACKED.sub("", topic)
        if base not in forms or (topic == base) == depth:
            forms[base] = topic
    return list(forms.values())


def _is_depth(topic: str, picture: Picture) -> bool:
    """By encoding; a PNG says nothing, so then by name."""
    return is_depth(picture) or (
        picture.encoding == "compressed" and "depth" in topic and bytes(picture.data[:4]) == b"\x89PNG"
    )


def _aligned(color: Picture, depth: Picture) -> bool:
    """True if depth seems to be registered to colour: same frame, same size."""
    try:
        return color.frame_id == depth.frame_id and size_of(color) == size_of(depth)
    except InputError:
        return False


def _info(
    log: Log, topic: str, picture: Picture, infos: Mapping[str, Calibration], given: str | None
) -> Calibration | None:
    """The calibration of a picture's topic: the one named, beside it, of its frame, or the only one."""
    if given is not None:
        if given not in infos:
            raise InputError(f"{log.path}: {given} has no calibration within its first seconds")
        return infos[given]
    base = _PACKED.sub("", topic)
    parent = base.rpartition("/")[0]
    for name in (f"{parent}/camera_info", f"{base}/camera_info", f"{base}/calibration", f"{parent}/calibration"):
        if name in infos:
            return infos[name]
    of_frame = [info for info in infos.values() if info.frame_id == picture.frame_id]
    fitting = of_frame or list(infos.values())
    return fitting[0] if len(fitting) == 1 else None


def _listed(names: Iterable[str]) -> str:
    found = sorted(name for name in names if name)
    return ", ".join(found[:12]) + (f" and {len(found) - 12} more" if len(found) > 12 else "") or "none"
