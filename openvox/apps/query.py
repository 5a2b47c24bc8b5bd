"""query: which instances of a map fit a text best."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from openvox.apps.described import described
from openvox.apps.info import check_kind
from openvox.apps.living.questions import ask
from openvox.apps.ranking import likeness, ranked
from openvox.apps.words import encoder_of
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import read_map

FITS = 0.45
"""Likeness from which on the first answer is taken for one; docs/perception.md has what it costs."""
FIELDS = ("instance", "caption", "score", "center", "bounds", "voxels")


def query(map_file: Path, texts: Sequence[str], *, top: int = 3, models: Path | None = None) -> dict[str, Any]:
    """The `top` best instances for each text, by likeness to what was said of them, the lower id among equals.

    `found` is false where even the best fits too little, or the map has no instances; the nearest are given all the
    same. models: the TOML file that `perceive` had, if its encoder is none of openvox. Lengths in metres.
    Raises InputError.
    """
    _check(texts, top)
    check_kind(map_file, "map")
    return {"queries": answers(read_map(map_file), str(map_file), texts, top, models)}


def query_live(address: str, texts: Sequence[str], *, top: int = 3) -> dict[str, Any]:
    """The same of the map of a live run that listens at HOST:PORT, as it stands. Raises InputError."""
    _check(texts, top)
    return ask(address, texts, top)


def _check(texts: Sequence[str], top: int) -> None:
    if top < 1:
        raise InputError(f"--top is {top}; expected 1 or more")
    for text in texts:
        if not text.strip():
            raise InputError("a text to look for is empty; say in words what you look for")


def answers(
    result: InstanceMap, name: str, texts: Sequence[str], top: int, models: Path | None = None
) -> list[dict[str, Any]]:
    """`queries` of the command's JSON. name: of the map, for sentences. Raises InputError."""
    try:
        scores = likeness(result, encoder_of(result, models), texts)
    except InputError as error:
        raise InputError(f"{name} cannot be asked in words: {error}") from None
    instances = described(result)
    queries = []
    for text, row in zip(texts, scores, strict=True):
        best = [{**instances[i], "score": float(row[i])} for i in ranked(row)[:top]]
        answered = [{name: answer[name] for name in FIELDS} for answer in best]
        queries.append({"text": text, "found": bool(answered) and answered[0]["score"] >= FITS, "answers": answered})
    return queries
