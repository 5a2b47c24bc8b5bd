"""Weights for packages that run on torch: tensors and nothing else, since a pickle can run anything."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.perception.onnx import first_line


def torch_device() -> str:
    """ "CUDA" if torch is there and sees such a GPU, else "CPU"."""
    try:
        import torch
    except ImportError:
        return "CPU"
    return "CUDA" if torch.cuda.is_available() else "CPU"


def with_weights(model: Any, file: Path, name: str) -> Any:
    """The torch module `model` with the tensors of a file. name: what weights are wanted. Raises InputError."""
    tensors = _read(file)
    try:
        model.load_state_dict(tensors)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise InputError(f"{file}: not the weights of {name} ({first_line(error)})") from None
    return model


def _read(file: Path) -> Any:
    """Names to tensors, on the CPU, of a .safetensors file or one of torch.save."""
    try:
        if file.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(str(file))
        import torch

        return torch.load(str(file), map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises pickle's, zip's and its own
        raise InputError(
            f"{file}: cannot be read as tensors only ({first_line(error)}); docs/models.md says how to make such a file"
        ) from None
