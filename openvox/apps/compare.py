"""compare: two maps or two traces: the same or not, where they part first, and what it meant for the instances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from openvox.apps.comparing import arrays
from openvox.apps.comparing.decisions import FIELDS, OUTCOME, Difference, first_difference
from openvox.apps.comparing.matching import Matching, differing_voxels, match_instances
from openvox.apps.info import kind_of
from openvox.apps.origin import belonging, named_digest
from openvox.core.digest import map_digest
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap, InstanceSummary
from openvox.formats.atomic import check_not_input
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.map_npz import read_map
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.trace import TraceInfo, trace_info

THRESHOLD = "association.threshold"


@dataclass(frozen=True)
class Side:
    """One of the two runs: its map, its trace, or both if they lie beside each other and belong together."""

    map_file: Path | None
    trace_file: Path | None
    map: InstanceMap | None
    trace: TraceInfo | None

    @property
    def about(self) -> Mapping[str, Any]:
        """preset and parameters of the run."""
        return self.map.meta if self.map is not None else self.trace.run if self.trace is not None else {}

    @property
    def passes(self) -> int:
        """How often the frames were mapped."""
        before = self.about.get("passes_before")
        return 1 + (len(before) if isinstance(before, list) else 0)

    @property
    def inputs(self) -> dict[str, Any]:
        """Digests of the recording and the perception that were mapped."""
        if self.map is not None:
            return {name: named_digest(self.map, name) for name in ("recording", "perception")}
        sources = self.about.get("sources", {})
        return {name: sources[name][1] if name in sources else None for name in ("recording", "perception")}


def compare(a: Path, b: Path, *, rerun: Path | None = None) -> dict[str, Any]:
    """The contract's fields of `compare --json`, and what docs/comparing.md lists beside them.

    a, b: two maps or two traces. What lies beside them (STEM.map.npz and STEM.trace.mcap of one run) is looked at, too.
    rerun: a file (.rrd) to write with both maps side by side. Raises InputError, OutputError."""
    kind = _one_kind(a, b)
    one, other = (_map_side(a), _map_side(b)) if kind == "map" else (_trace_side(a), _trace_side(b))
    if rerun is not None:
        check_not_input(rerun, *belonging(a, one.about), *belonging(b, other.about))
    parameters = _differing(one.about.get("parameters", {}), other.about.get("parameters", {}))
    first = outcome = None
    if one.trace is not None and other.trace is not None:
        first, outcome = _decisions(one, other, parameters)
    matching = None if one.map is None or other.map is None else match_instances(one.map, other.map)
    if kind == "map":
        assert one.map is not None
        assert other.map is not None
        same = _same_maps(one.map, other.map)
        difference = None if same else arrays.first_difference(one.map, other.map)
    else:
        assert one.trace is not None
        assert other.trace is not None
        same = one.trace.digest == other.trace.digest
        difference = None if first is None else asdict(first)
    result = {
        "same": same,
        "kind": kind,
        "first_difference": difference,
        "first_decision": first and asdict(first),
        "first_outcome": outcome and asdict(outcome),
        "parameters": parameters,
        "inputs": _differing(one.inputs, other.inputs),
        "a": _described(one),
        "b": _described(other),
        **_instances(one.map, other.map, matching),
        "notes": _notes(kind, one, other),
        "rerun": None if rerun is None else str(rerun),
    }
    if rerun is not None:
        _draw(rerun, one, other, matching, result)
    return result


def first_outcome(a: Path, b: Path) -> Difference | None:
    """The first mask of two traces that went another way, whatever the scores. Raises InputError."""
    return None if trace_info(a).digest == trace_info(b).digest else first_difference(a, b, OUTCOME)


def _one_kind(a: Path, b: Path) -> str:
    kinds = [kind_of(path) for path in (a, b)]
    for path, kind in zip((a, b), kinds, strict=True):
        if kind not in ("map", "trace"):
            raise InputError(f"{path} is a {kind} file; compare takes two maps or two traces, as replay writes them")
    if kinds[0] != kinds[1]:
        raise InputError(f"{a} is a {kinds[0]}, {b} a {kinds[1]}; compare two maps or two traces")
    return kinds[0]


def _map_side(path: Path) -> Side:
    found = read_map(path)
    beside = path.with_name(path.name.removesuffix(MAP_SUFFIX) + TRACE_SUFFIX)
    trace = trace_info(beside) if beside.is_file() else None
    if trace is None or trace.digest != named_digest(found, "trace"):
        return Side(path, None, found, None)
    return Side(path, beside, found, trace)


def _trace_side(path: Path) -> Side:
    trace = trace_info(path)
    beside = path.with_name(path.name.removesuffix(TRACE_SUFFIX) + MAP_SUFFIX)
    found = read_map(beside) if beside.is_file() else None
    if found is None or named_digest(found, "trace") != trace.digest:
        return Side(None, path, None, trace)
    return Side(beside, path, found, trace)


def _same_maps(a: InstanceMap, b: InstanceMap) -> bool:
    return map_digest(a) == map_digest(b) and a.voxel_size == b.voxel_size and a.vote_unit == b.vote_unit


def _differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Names in a's order, then b's own; None where one has no such name."""
    return {name: {"a": a.get(name), "b": b.get(name)} for name in {**a, **b} if a.get(name) != b.get(name)}


def _decisions(one: Side, other: Side, parameters: Mapping[str, Any]) -> tuple[Difference | None, Difference | None]:
    """The first field that differs, and the first mask that went another way; None if there is none.

    A threshold that was set differently stands in every decision, and is named only if nothing else differs."""
    assert one.trace is not None
    assert other.trace is not None
    if one.trace.digest == other.trace.digest:
        return None, None
    a, b = one.trace.path, other.trace.path
    fields = tuple(field for field in FIELDS if field != "threshold" or THRESHOLD not in parameters)
    first = first_difference(a, b, fields)
    if first is None:
        return first_difference(a, b, FIELDS), None
    return first, first_difference(a, b, OUTCOME, first.frame)


def _described(side: Side) -> dict[str, Any]:
    trace, found = side.trace, side.map
    return {
        "map": None if side.map_file is None else str(side.map_file),
        "trace": None if side.trace_file is None else str(side.trace_file),
        "preset": side.about.get("preset"),
        "frames": trace.frames if trace is not None else side.about.get("frames"),
        "passes": side.passes,
        "map_digest": None if found is None else map_digest(found),
        "trace_digest": None if trace is None else trace.digest,
        "voxels": None if found is None else len(found.voxel_index),
        "voxel_size": None if found is None else found.voxel_size,
        "instances": None if found is None else len(found.instance_id),
    }


def _instances(a: InstanceMap | None, b: InstanceMap | None, matching: Matching | None) -> dict[str, Any]:
    """`instances` (ids of a, `appeared` of b) and what they are; None without maps."""
    if a is None or b is None or matching is None:
        return {
            "instances": None,
            "matches": None,
            "split_into": None,
            "merged_into": None,
            "agreement": None,
            "appeared": None,
            "vanished": None,
        }
    of_a = {summary.id: summary for summary in a.instances}
    of_b = {summary.id: summary for summary in b.instances}
    renamed = [match for match in matching.matches if _renamed(of_a[match.a], of_b[match.b])]
    elsewhere = differing_voxels(matching, a, b)[0]
    held = a.voxel_instance > 0
    return {
        "instances": {
            "split": list(matching.split),
            "merged": sorted({i for parts in matching.merged.values() for i in parts}),
            "appeared": list(matching.appeared),
            "vanished": list(matching.vanished),
            "renamed": [match.a for match in renamed],
        },
        "matches": [
            {
                "a": match.a,
                "b": match.b,
                "iou": match.iou,
                "a_voxels": of_a[match.a].voxels,
                "b_voxels": of_b[match.b].voxels,
                "a_caption": of_a[match.a].caption,
                "b_caption": of_b[match.b].caption,
            }
            for match in matching.matches
        ],
        "split_into": [
            {"a": _named(of_a[i]), "b": [_named(of_b[j]) for j in pieces]} for i, pieces in matching.split.items()
        ],
        "merged_into": [
            {"a": [_named(of_a[i]) for i in parts], "b": _named(of_b[j])} for j, parts in matching.merged.items()
        ],
        "appeared": [_named(of_b[j]) for j in matching.appeared],
        "vanished": [_named(of_a[i]) for i in matching.vanished],
        "agreement": float(1.0 - elsewhere[held].mean()) if held.any() else None,
    }


def _renamed(one: InstanceSummary, other: InstanceSummary) -> bool:
    """Neither was ever called what the other is called: of two captions that both got, either may lead."""
    return one.caption not in {other.caption, *(text for text, _ in other.captions)} and other.caption not in {
        text for text, _ in one.captions
    }


def _named(summary: Any) -> dict[str, Any]:
    return {"instance": summary.id, "caption": summary.caption, "voxels": summary.voxels}


def _notes(kind: str, one: Side, other: Side) -> list[str]:
    notes = []
    lacking = [str(s.map_file or s.trace_file) for s in (one, other) if (s.trace if kind == "map" else s.map) is None]
    if lacking:
        what = "decisions: no trace" if kind == "map" else "instances: no map"
        notes.append(f"nothing about {what} of the same run lies beside {' and '.join(lacking)}")
    if one.map is not None and other.map is not None and one.map.voxel_size != other.map.voxel_size:
        notes.append(
            f"voxels of {one.map.voxel_size:g} and {other.map.voxel_size:g} m are compared by place: the centre of "
            "each is looked up in the other map, within 1.5 of its edges"
        )
    if one.passes != other.passes:
        notes.append(f"the frames were mapped {_times(one.passes)} in A, {_times(other.passes)} in B (replay --passes)")
    if one.inputs["recording"] != other.inputs["recording"]:
        notes.append("the two were made from different recordings; instances are compared by their place in the world")
    return notes


def _times(passes: int) -> str:
    return "once" if passes == 1 else f"{passes} times"


def _draw(out: Path, one: Side, other: Side, matching: Matching | None, result: Mapping[str, Any]) -> None:
    if matching is None or one.map is None or other.map is None:
        raise InputError("--rerun draws maps, but no map lies beside these traces; compare the maps of the two runs")
    from openvox.apps.comparing.drawing import kinds_of_voxels, markdown
    from openvox.view.compare_rerun import Drawn, draw_comparison  # rerun

    kinds = kinds_of_voxels(matching, one.map, other.map)
    titles = [f"{name}: {side.map_file.name}" for name, side in zip("AB", (one, other), strict=True) if side.map_file]
    sides = [Drawn(*each) for each in zip((one.map, other.map), kinds, titles, strict=True)]
    draw_comparison(sides[0], sides[1], markdown(result), out)
