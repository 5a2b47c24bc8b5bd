"""From words to the vectors that a map's features can be compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from openvox.core.errors import InputError
from openvox.core.types import InstanceMap

if TYPE_CHECKING:
    from openvox.perception.encoder import TextEncoder


def encoder_of(result: InstanceMap) -> TextEncoder:
    """The encoder that made the map's features. Raises InputError: the map has none, or openvox does not."""
    from openvox.perception.encoder import encoder  # a model

    name = result.meta.get("encoder")
    if not isinstance(name, str) or not name:
        raise InputError("the map has no embeddings: perceive the recording with an encoder, and replay it")
    found = encoder(name)
    dimensions = result.feature.shape[1]
    if len(result.instance_id) and found.dimensions != dimensions:
        raise InputError(
            f"the map's features have {dimensions} numbers, vectors of {name} {found.dimensions}; "
            "replay the recording with this openvox"
        )
    return found
