"""A category for every instance of a map: the nearest of given names, else the noun of its caption if that names it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from openvox.apps.ranking import cosines
from openvox.apps.scoring.semantics import read_classes, spoken
from openvox.apps.uses import noun_of
from openvox.apps.words import encoder_of
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap

UNNAMED = "unnamed"


def categories_of(result: InstanceMap, classes: Path | None) -> tuple[str, ...]:
    """One an instance, as instance_id. classes: a file with a name a line. Raises InputError.

    With classes, the name whose text is nearest to the instance's feature, the first on a tie, as `evaluate` does."""
    if classes is None:
        return tuple((one.named and noun_of(one.caption)) or UNNAMED for one in result.instances)
    names = read_classes(classes)
    try:
        return nearest_names(result, names)
    except InputError as error:
        raise InputError(f"--classes {classes} cannot be used: {error}") from None


def nearest_names(result: InstanceMap, names: Sequence[str]) -> tuple[str, ...]:
    """The nearest name of each instance. Raises InputError: the map has no embeddings."""
    nearest = np.argmax(cosines(result.feature, encoder_of(result).encode([spoken(name) for name in names])), axis=0)
    return tuple(names[place] for place in nearest.tolist())
