"""query: which instances of a map fit a text best."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from openvox.apps.described import described
from openvox.apps.scoring.semantics import cosines, ranked
from openvox.apps.words import encoder_of
from openvox.core.errors import InputError
from openvox.formats.map_npz import read_map

FIELDS = ("instance", "caption", "score", "center", "bounds", "voxels")


def query(map_file: Path, texts: Sequence[str], *, top: int = 3) -> dict[str, Any]:
    """The `top` best instances for each text, by cosine with their features, the lower id among equals.

    `found` is false only if the map has no instances: the best answer is given however little it fits. Lengths in
    metres. Raises InputError.
    """
    if top < 1:
        raise InputError(f"--top is {top}; expected 1 or more")
    for text in texts:
        if not text.strip():
            raise InputError("a text to look for is empty; say in words what you look for")
    result = read_map(map_file)
    try:
        vectors = encoder_of(result).encode(list(texts))
    except InputError as error:
        raise InputError(f"{map_file} cannot be asked in words: {error}") from None
    instances = described(result)
    queries = []
    for text, cosine in zip(texts, cosines(result.feature, vectors), strict=True):
        best = [{**instances[row], "score": float(cosine[row])} for row in ranked(cosine)[:top]]
        answers = [{name: answer[name] for name in FIELDS} for answer in best]
        queries.append({"text": text, "found": bool(answers), "answers": answers})
    return {"queries": queries}
