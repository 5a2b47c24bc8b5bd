"""The stages there are, one row each, and which of them a front end or a TOML file of the user's puts together.

A row says where a stage is made: called with its options (the `Options` of what makes it, a group of parameters filled
from the TOML file) and a `Setting`, it returns a stage as `stage.py` describes them. docs/stages.md walks through one.
"""

from __future__ import annotations

import dataclasses
import difflib
import importlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from openvox.core.errors import InputError
from openvox.core.parameters import Value, from_toml, updated
from openvox.formats.recording import RecordingInfo
from openvox.perception.captions import Texts
from openvox.perception.parameters import PerceptionParameters
from openvox.perception.pipeline import Pipeline


class Row(NamedTuple):
    """Where a stage is made, module:name, and the groups of --set that it takes numbers from."""

    where: str
    groups: tuple[str, ...] = ()


STAGES: Mapping[str, dict[str, Row]] = {
    "det": {
        "yolo-world": Row("openvox.perception.det.yolo:Yolo"),
        "yolo": Row("openvox.perception.det.yolo:Yolo"),
        "nanodet": Row("openvox.perception.shipped:nanodet", ("offline",)),
        "truth": Row("openvox.perception.shipped:truth_boxes", ("oracle",)),
        "none": Row("openvox.perception.shipped:no_boxes"),
    },
    "segcap": {
        "sam": Row("openvox.perception.segcap.sam:Sam"),
        "tap": Row("openvox.perception.segcap.tap:Tap"),
        "offline": Row("openvox.perception.shipped:offline", ("geometry", "offline")),
        "geometry": Row("openvox.perception.shipped:geometry", ("geometry",)),
        "truth": Row("openvox.perception.shipped:truth_masks", ("oracle",)),
    },
    "enc": {
        "minilm": Row("openvox.perception.shipped:minilm"),
        "sentence-transformers": Row("openvox.perception.enc.sentences:SentenceTransformers"),
    },
}
FRONTENDS: Mapping[str, Mapping[str, str]] = {
    "offline": {"det": "nanodet", "segcap": "offline", "enc": "minilm"},
    "geometry": {"det": "none", "segcap": "geometry", "enc": "minilm"},
    "oracle": {"det": "truth", "segcap": "truth", "enc": "minilm"},
}
"""Stage of each role; a TOML file that leaves a role out gets that of `offline`."""
LARGEST_TOML = 1 << 20


@dataclass(frozen=True)
class Chosen:
    """The stage of each role, and what a TOML file says of it. `name`: of the front end. `asked_by`: what to call it in
    errors. `folder`: where paths count from. `assigned`: options of --set, by dotted name, whose paths count from the
    current folder; they go before those of the file."""

    name: str
    names: Mapping[str, str]
    options: Mapping[str, Mapping[str, Value]]
    asked_by: str
    folder: Path
    assigned: Mapping[str, Value] = field(default_factory=dict)

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of --set that have an effect."""
        return tuple(dict.fromkeys(group for role, name in self.names.items() for group in STAGES[role][name].groups))


@dataclass(frozen=True)
class Setting:
    """What a stage may ask about when it is made."""

    recording: RecordingInfo | None
    """None where only an encoder is made, to ask a map."""
    parameters: PerceptionParameters
    asked_by: str
    root: Path
    """Where paths of the TOML file count from: its own folder."""
    assigned: Collection[str] = ()
    """Options that --set gave; their paths count from the current folder."""

    def file(self, option: str, value: str) -> Path:
        """The path that an option names; it must be a file. Raises InputError."""
        path = self._path(option, value)
        if not path.is_file():
            raise self._lacking(option, value, path, "a file")
        return path

    def folder(self, option: str, value: str) -> Path:
        """The same for a folder."""
        path = self._path(option, value)
        if not path.is_dir():
            raise self._lacking(option, value, path, "a folder")
        return path

    def _path(self, option: str, value: str) -> Path:
        return Path("" if option in self.assigned else self.root) / Path(value).expanduser()

    def _lacking(self, option: str, value: str, path: Path, what: str) -> InputError:
        if not value:
            return InputError(f"{self.asked_by}: {option} is missing; expected the path of {what}")
        if option in self.assigned:
            return InputError(f"--set: {option} is {value!r}, which is not {what}; paths count from the current folder")
        return InputError(
            f"{self.asked_by}: {option} is {value!r}, but {path} is not {what}; paths count from the folder of "
            f"{Path(self.asked_by).name}"
        )


def of_frontend(name: str) -> Chosen:
    """The stages of a front end that comes with openvox."""
    return Chosen(name, FRONTENDS[name], {}, f"--frontend {name}", Path())


def read_models(path: Path) -> Chosen:
    """The stages of a TOML file: tables [det], [segcap], [enc], with `stage` and options. Raises InputError."""
    if not path.is_file() or path.stat().st_size > LARGEST_TOML:
        found = "is no file of a few lines" if path.exists() else "is not there"
        raise InputError(f"{path} {found}; --models wants a TOML file with tables {_roles()}")
    names = dict(FRONTENDS["offline"])
    options: dict[str, dict[str, Value]] = {role: {} for role in STAGES}
    for name, value in from_toml(path).items():
        role, _, key = name.partition(".")
        if role not in STAGES:
            raise InputError(f"{path}: there is no stage [{role}]; expected {_roles()}")
        if key == "stage":
            names[role] = _known(str(value), STAGES[role], f"{path}: [{role}] stage")
        else:
            options[role][key] = value
    return Chosen("models", names, options, str(path), path.parent)


def assigned(chosen: Chosen, changes: Mapping[str, Value]) -> Chosen:
    """With options of stages from --set, as in det.score=0.2, before those of the TOML file. Raises InputError."""
    for name in changes:
        if chosen.name != "models":
            raise InputError(
                f"--set: {name} is for the stages of --models FILE.toml; give such a file, or leave it out"
            )
        if name.startswith("enc."):
            raise InputError(f"--set: {name} must stand in {chosen.asked_by}, because maps are asked with it as well")
    return dataclasses.replace(chosen, assigned=changes) if changes else chosen


def pipeline_of(chosen: Chosen, recording: RecordingInfo, parameters: PerceptionParameters) -> Pipeline:
    """Det, SegCap and Enc, each module imported now that it is used. Raises InputError, also for unfit models."""
    setting = Setting(recording, parameters, chosen.asked_by, chosen.folder, chosen.assigned.keys())
    det, segcap, enc = (_made(role, chosen, setting) for role in STAGES)
    return Pipeline(det, segcap, enc)


def encoder_to_ask(chosen: Chosen) -> Texts:
    """The sentence encoder of [enc] alone, for what a map is asked. Raises InputError."""
    made = _made("enc", chosen, Setting(None, PerceptionParameters(), chosen.asked_by, chosen.folder))
    texts: Texts | None = getattr(made, "texts", None)
    if texts is None:
        raise InputError(
            f"{chosen.asked_by}: [enc] {chosen.names['enc']} takes no texts, so that a map cannot be asked"
        )
    return texts


def _made(role: str, chosen: Chosen, setting: Setting) -> Any:
    row = STAGES[role][chosen.names[role]]
    module, _, name = row.where.partition(":")
    make = getattr(importlib.import_module(module), name)
    kind = getattr(make, "Options", None)
    options = kind() if kind else None
    of_set = {name.partition(".")[2]: v for name, v in chosen.assigned.items() if name.partition(".")[0] == role}
    for source, given in ((chosen.asked_by, chosen.options.get(role, {})), ("--set", of_set)):
        for key in given:
            _check_option(key, options, f"{source}: [{role}] {chosen.names[role]}", row)
        if given:
            options = _filled(role, options, given, source)
    return make(options, setting)


def _filled(role: str, options: Any, given: Mapping[str, Value], source: str) -> Any:
    """`updated` checks a set of groups: here one group, named as the table of the file."""
    one = dataclasses.make_dataclass("Group", [(role, type(options))], frozen=True)
    return getattr(updated(one(options), {f"{role}.{key}": v for key, v in given.items()}, source=source), role)


def _check_option(key: str, options: Any, where: str, row: Row) -> None:
    names = [field.name for field in dataclasses.fields(options)] if options else []
    if names:
        _known(key, names, f"{where}: an option")
    else:
        groups = " and ".join(f"--set {group}.NAME=VALUE" for group in row.groups)
        raise InputError(
            f"{where} has no options, but {key!r} was given; " + (f"use {groups}" if groups else "leave it out")
        )


def _known(name: str, names: Any, where: str) -> str:
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        raise InputError(f"{where} is {name!r}; expected {', '.join(names) or 'none'}{hint}")
    return name


def _roles() -> str:
    return ", ".join(f"[{role}]" for role in STAGES)
