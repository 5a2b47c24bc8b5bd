"""From words to the vectors that a map's features can be compared with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from openvox.core.errors import InputError
from openvox.core.types import InstanceMap

if TYPE_CHECKING:
    from openvox.perception.captions import Texts


def encoder_of(result: InstanceMap, models: Path | None = None) -> Texts:
    """The encoder that made the map's features: one of openvox, or that of a TOML file of models.

    Raises InputError: the map has none, openvox does not, or the file names another; or one of that name with other
    files, whose vectors cannot be compared."""
    name = result.meta.get("encoder")
    if not isinstance(name, str) or not name:
        raise InputError("the map has no embeddings: perceive the recording with an encoder, and replay it")
    found = _encoder(name, models)
    made_by = result.meta.get("encoder_model")  # maps of openvox before 0.6 do not say
    if made_by and made_by != found.model_digest:
        raise InputError(
            f"the map's features were made by other files of a model that is called {name} too; ask with the TOML file "
            "that openvox perceive was given (--models), or perceive and replay the recording again"
        )
    dimensions = result.feature.shape[1]
    if len(result.instance_id) and found.dimensions != dimensions:
        raise InputError(
            f"the map's features have {dimensions} numbers, vectors of {name} {found.dimensions}; "
            "replay the recording with this openvox"
        )
    return found


def _encoder(name: str, models: Path | None) -> Texts:
    if models is None:
        from openvox.perception.encoder import encoder  # a model

        return encoder(name)
    from openvox.perception.stages import encoder_to_ask, read_models

    found = encoder_to_ask(read_models(models))
    if found.name != name:
        raise InputError(
            f"the map's features are those of {name}, {models} names {found.name}; give the file it was made with"
        )
    return found
