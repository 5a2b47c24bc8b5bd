"""How each voxel of two maps differs, as a picture shows it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openvox.apps.comparing.matching import Matching, differing_voxels
from openvox.core.types import InstanceMap
from openvox.view.decision_table import escaped
from openvox.view.differences import ELSEWHERE, GONE, MERGED, NEW, SAME, SPLIT

Kinds = NDArray[np.uint8]


def kinds_of_voxels(matching: Matching, a: InstanceMap, b: InstanceMap) -> tuple[Kinds, Kinds]:
    """For each voxel of both maps, one of view.differences' kinds."""
    in_a, in_b = (np.where(apart, ELSEWHERE, SAME).astype(np.uint8) for apart in differing_voxels(matching, a, b))
    _mark(in_a, a, matching.split, SPLIT)
    _mark(in_a, a, {i for parts in matching.merged.values() for i in parts}, MERGED)
    _mark(in_a, a, matching.vanished, GONE)
    _mark(in_b, b, {j for pieces in matching.split.values() for j in pieces}, SPLIT)
    _mark(in_b, b, matching.merged, MERGED)
    _mark(in_b, b, matching.appeared, NEW)
    return in_a, in_b


def _mark(kinds: Kinds, one: InstanceMap, instances: Collection[int], kind: int) -> None:
    kinds[np.isin(one.voxel_instance, sorted(instances))] = kind


def markdown(result: Mapping[str, Any]) -> str:
    """What compare found, as the text beside the picture."""
    lines = [f"- {name}: {values['a']} → {values['b']}" for name, values in result["parameters"].items()]
    for row in result["split_into"]:
        lines.append(f"- split: {_one(row['a'])} into {', '.join(map(_one, row['b']))}")
    for row in result["merged_into"]:
        lines.append(f"- merged: {', '.join(map(_one, row['a']))} into {_one(row['b'])}")
    for what in ("appeared", "vanished"):
        lines += [f"- {what}: {_one(row)}" for row in result[what]]
    lines += [
        f"- renamed: {match['a']} ({escaped(match['a_caption'])}) is {match['b']} ({escaped(match['b_caption'])})"
        for match in result["matches"]
        if match["a"] in result["instances"]["renamed"]
    ]
    first = result["first_outcome"]
    if first is not None:
        mask = "" if first["mask"] is None else f", mask {first['mask']}"
        lines.append(
            f"- first other decision: frame {first['frame']}{mask}: {first['field']} {first['a']} → {first['b']}"
        )
    return "\n".join(lines) or "Nothing differs."


def _one(row: Mapping[str, Any]) -> str:
    return f"{row['instance']} ({escaped(row['caption'])}, {row['voxels']} voxels)"
