"""Models in ONNX files, run on the CPU by one thread each: frames are what is done side by side."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from openvox.core.errors import InputError


class Model:
    """A loaded file. `digest`: SHA-256 over it and the files that belong to it. `metadata`: texts kept in the file.

    Safe to run from several threads. Raises InputError if a file cannot be read."""

    def __init__(self, file: Path, *others: Path) -> None:
        import onnxruntime

        self.digest = digest_of_files(file, *others)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
        self.metadata: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map

    def run(self, outputs: Sequence[str], **inputs: NDArray[Any]) -> list[NDArray[Any]]:
        """The named outputs for the named inputs."""
        found: list[NDArray[Any]] = self._session.run(list(outputs), inputs)
        return found

    def width(self, output: int = 0) -> int:
        """Length of the last axis of an output."""
        length: int = self._session.get_outputs()[output].shape[-1]
        return length


def digest_of_files(*files: Path) -> str:
    """SHA-256 over the bytes of files that came with openvox, one after the other. Raises InputError."""
    digest = hashlib.sha256()
    for file in files:
        try:
            digest.update(file.read_bytes())
        except OSError as error:
            raise InputError(
                f"{file}: the model's file cannot be read ({error.strerror}); install openvox again"
            ) from None
    return digest.hexdigest()
