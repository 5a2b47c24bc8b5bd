"""What a sweep maps: every recording with every combination of parameter values, checked before anything is done."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from openvox import __version__
from openvox.apps.replay import chosen_parameters
from openvox.core.digest import digest_of
from openvox.core.errors import InputError
from openvox.core.parameters import Value, as_dict, from_assignments
from openvox.formats.perception import SUFFIX as PERCEPTION_SUFFIX
from openvox.formats.perception import perception_info
from openvox.formats.recording import recording_info
from openvox.formats.truth import read_truth

MAX_SETS = 100_000


@dataclass(frozen=True)
class Source:
    """A recording, its perception and its truth."""

    name: str
    path: Path
    perception: Path
    truth: Path | None
    digests: Mapping[str, str]
    """recording, perception, and truth if there is one."""


@dataclass(frozen=True)
class ParameterSet:
    """One combination of values."""

    number: int
    values: Mapping[str, Value]
    """By the names of the parameters that vary."""
    assignments: tuple[str, ...]
    """As replay takes them."""
    parameters: Mapping[str, Value]
    """All of them."""
    default: bool
    """The values that the preset gives."""
    grid: bool
    """It was asked for; the default set is always mapped."""


@dataclass(frozen=True)
class Run:
    """What is the same for all items."""

    preset: str
    params: Path | None
    engine: str
    start: int | None
    end: int | None
    stride: int


@dataclass(frozen=True)
class Item:
    """One recording with one set: all that a process needs to know to do it."""

    number: int
    source: Source
    set: ParameterSet
    run: Run
    stem: Path
    """Of its files: STEM.map.npz, STEM.trace.mcap, STEM.json."""

    @property
    def key(self) -> str:
        """Digest of all that its map depends on."""
        inputs = {name: self.source.digests[name] for name in ("recording", "perception")}
        run = {"preset": self.run.preset, "start": self.run.start, "end": self.run.end, "stride": self.run.stride}
        return digest_of({**inputs, **run, "parameters": dict(self.set.parameters), "openvox": __version__})


def parameter_sets(run: Run, assignments: Sequence[str]) -> tuple[dict[str, list[Value]], list[ParameterSet]]:
    """Values by parameter, and all combinations of them, the last parameter varying fastest; then the default set if
    it is not among them. A parameter with one value beside others of several has it in every set, the default included;
    where none has several, the one set asked for is compared with the preset's own. Raises InputError."""
    texts = {name: _values(name, str(text)) for name, text in from_assignments(assignments).items()}
    if not texts:
        raise InputError("--set is missing: name a parameter and its values, as in --set association.threshold=0.3,0.4")
    varied = {name: values for name, values in texts.items() if len(values) > 1} or texts
    fixed = [f"{name}={values[0]}" for name, values in texts.items() if name not in varied]
    number = 1
    for values in varied.values():
        number *= len(values)
    if number > MAX_SETS:
        raise InputError(f"--set asks for {number} combinations; expected at most {MAX_SETS}, so take fewer values")
    default = as_dict(chosen_parameters(run.preset, run.params, fixed))
    sets = []
    for place, combination in enumerate(itertools.product(*varied.values())):
        chosen = [*fixed, *(f"{name}={value}" for name, value in zip(varied, combination, strict=True))]
        sets.append(_set(place, run, chosen, varied, default, grid=True))
    _check_duplicates(varied, sets)
    if not any(one.default for one in sets):
        sets.append(_set(len(sets), run, fixed, varied, default, grid=False))
    found = {name: list(dict.fromkeys(one.values[name] for one in sets if one.grid)) for name in varied}
    return found, sets


def _values(name: str, text: str) -> list[str]:
    values = [value.strip() for value in text.split(",")]
    if not all(values):
        raise InputError(f"--set {name}={text}: a value is empty; expected values with commas between them")
    return values


def _set(
    number: int, run: Run, chosen: Sequence[str], varied: Mapping[str, Any], default: Mapping[str, Value], *, grid: bool
) -> ParameterSet:
    parameters = as_dict(chosen_parameters(run.preset, run.params, chosen))
    values = {name: parameters[name] for name in varied}
    return ParameterSet(number, values, tuple(chosen), parameters, parameters == default, grid)


def _check_duplicates(varied: Mapping[str, Sequence[str]], sets: Sequence[ParameterSet]) -> None:
    for name, values in varied.items():
        if len({one.values[name] for one in sets}) < len(values):
            raise InputError(f"--set {name}={','.join(values)}: a value is given twice; give each once")


def sources(recordings: Sequence[Path], perceptions: Sequence[Path], truths: Sequence[Path]) -> list[Source]:
    """The recordings with what belongs to them. Raises InputError."""
    stems = [path.stem for path in recordings]
    names = stems if len(set(stems)) == len(stems) else [str(path) for path in recordings]
    perceived = _one_each("--perception", perceptions, recordings, several_only=len(recordings) > 1)
    truth = _one_each("--truth", truths, recordings)
    found = [_source(*each) for each in zip(names, recordings, perceived, truth, strict=True)]
    if len({(one.digests["recording"], one.digests["perception"]) for one in found}) < len(found):
        raise InputError("two of the recordings are the same, with the same perception; name each once")
    return found


def _one_each(
    option: str, given: Sequence[Path], recordings: Sequence[Path], *, several_only: bool = False
) -> list[Path | None]:
    """One for each recording: as many as recordings, or one for all."""
    if not given:
        return [None] * len(recordings)
    if len(given) == len(recordings):
        return list(given)
    if len(given) == 1 and not several_only:
        return [given[0]] * len(recordings)
    expected = "one for each, in their order" + ("" if several_only else ", or one for all")
    raise InputError(f"{option} is given {len(given)} times for {len(recordings)} recordings; expected {expected}")


def _source(name: str, recording: Path, perception: Path | None, truth: Path | None) -> Source:
    path = perception or recording.with_suffix(PERCEPTION_SUFFIX)
    if not path.exists():
        raise InputError(f"{path}: no such file; run openvox perceive {recording} first, or name one with --perception")
    digests = {"recording": recording_info(recording).digest, "perception": perception_info(path).digest}
    if truth is not None:
        digests["truth"] = truth_digest(truth)
    return Source(name, recording, path, truth, digests)


def truth_digest(truth: Path) -> str:
    """Of the points in a folder, or of the recording that they are made of. Raises InputError."""
    if not truth.is_dir():
        return recording_info(truth).digest
    known = read_truth(truth)
    return hashlib.sha256(known.points.tobytes() + known.instance.tobytes()).hexdigest()


def items(run: Run, found: Sequence[Source], sets: Sequence[ParameterSet], folder: Path) -> Iterator[Item]:
    """By recording, then by set. Files are named by what they are made from, so that another run finds them again."""
    for number, (source, one) in enumerate(itertools.product(found, sets)):
        item = Item(number, source, one, run, folder)
        yield replace(item, stem=folder / f"{source.path.stem}-{item.key[:12]}")


def elsewhere(item: Item) -> Item:
    """The item as another machine finds it: its paths from the root, which all machines must share."""
    source, run = item.source, item.run
    found = replace(
        source,
        path=source.path.resolve(),
        perception=source.perception.resolve(),
        truth=None if source.truth is None else source.truth.resolve(),
    )
    params = None if run.params is None else run.params.resolve()
    return replace(item, source=found, run=replace(run, params=params), stem=item.stem.resolve())
