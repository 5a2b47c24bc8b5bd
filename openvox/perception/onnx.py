"""Models in ONNX files: those that come with openvox on the CPU, always; those of the user on a GPU if there is one.

On the CPU each runs in one thread: frames are what is done side by side.
"""

from __future__ import annotations

import hashlib
import mmap
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import Lock
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError

CPU = "CPUExecutionProvider"
GPUS = {"CUDAExecutionProvider": "CUDA", "ROCMExecutionProvider": "ROCm", "MIGraphXExecutionProvider": "ROCm"}
"""onnxruntime's names for GPUs, best first, and what people call them."""
LARGEST = 8 << 30
"""Bytes; the largest models of these families have some 3 GB."""
TYPES: Mapping[str, type[np.generic]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
}
_OUTSIDE = re.compile(rb"\x0a\x08location\x12([\x01-\x7f])([^\x00-\x1f\x7f-\xff]+)")
"""Where a model says, in the protobuf that it is, that a tensor lies in a file beside it: key, length, name."""


class Model:
    """An ONNX file, loaded when it is first asked for more than its digest, SHA-256 over it and what belongs to it.

    Safe to use from several threads. Raises InputError if a file cannot be read."""

    def __init__(self, file: Path, *others: Path) -> None:
        self.file, self.digest = file, digest_of_files(file, *others)
        self._providers: Sequence[str] = [CPU]
        self._loaded: Any = None
        self._lock = Lock()

    @classmethod
    def of_user(cls, file: Path, *others: Path) -> Self:
        """A file that did not come with openvox: its size is checked, and where it says that its weights lie."""
        import onnxruntime

        weights = _weights_beside(file)
        for path in (file, *weights, *others):
            check_size(path)
        model = cls(file, *weights, *others)
        present = onnxruntime.get_available_providers()
        model._providers = [*(name for name in GPUS if name in present), CPU]
        return model

    def load(self) -> Any:
        """The session of onnxruntime, made once. Raises InputError if onnxruntime cannot make sense of the file."""
        with self._lock:
            if self._loaded is None:
                import onnxruntime

                options = onnxruntime.SessionOptions()
                options.intra_op_num_threads = 1
                options.log_severity_level = 3
                try:
                    self._loaded = onnxruntime.InferenceSession(self.file, options, providers=self._providers)
                except Exception as error:  # onnxruntime raises a dozen kinds that share no name
                    raise InputError(
                        f"{self.file}: cannot be loaded as an ONNX model ({first_line(error)}); export it again"
                    ) from None
            return self._loaded

    @property
    def device(self) -> str:
        """ "CPU" or the kind of GPU: what it runs on, or before it is loaded what will be tried first."""
        tried = self._providers if self._loaded is None else self._loaded.get_providers()
        return GPUS.get(tried[0], "CPU")

    @property
    def metadata(self) -> Mapping[str, str]:
        """Texts that are kept in the file."""
        found: Mapping[str, str] = self.load().get_modelmeta().custom_metadata_map
        return found

    @property
    def inputs(self) -> Mapping[str, tuple[str, Sequence[Any]]]:
        """Name to (type, shape), in order; None or a word stands for a side that is left open."""
        return {node.name: (node.type, node.shape) for node in self.load().get_inputs()}

    @property
    def outputs(self) -> Mapping[str, tuple[str, Sequence[Any]]]:
        """The same."""
        return {node.name: (node.type, node.shape) for node in self.load().get_outputs()}

    def run(self, outputs: Sequence[str], **inputs: NDArray[Any]) -> list[NDArray[Any]]:
        """The named outputs for the named inputs. Raises InputError if the model cannot work on them."""
        session = self.load()
        try:
            found: list[NDArray[Any]] = session.run(list(outputs), inputs)
        except Exception as error:  # onnxruntime raises a dozen kinds that share no name
            raise InputError(
                f"{self.file}: the model failed ({first_line(error)}); it has {self.signature()}"
            ) from None
        return found

    def run_all(self, values: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """All outputs by name. values: of at least the inputs, each brought to the type that the input has.

        Raises InputError, also for an input of another type than these models have."""
        wanted, outputs = self.inputs, list(self.outputs)
        if not {kind for kind, _ in wanted.values()} <= TYPES.keys():
            raise self.refused("inputs of type float, float16, int32 or int64")
        inputs = {name: values[name].astype(TYPES[kind], copy=False) for name, (kind, _) in wanted.items()}
        return dict(zip(outputs, self.run(outputs, **inputs), strict=True))

    def signature(self) -> str:
        """Inputs and outputs with types and shapes, for people."""
        return f"inputs {_listed(self.inputs)}, outputs {_listed(self.outputs)}"

    def refused(self, expected: str) -> InputError:
        """The error to raise about a file of another signature."""
        return InputError(f"{self.file} has {self.signature()}; expected {expected}")


def _listed(nodes: Mapping[str, tuple[str, Sequence[Any]]]) -> str:
    """As in "images float[1,3,640,640]"; a side that is left open is "?"."""
    texts = []
    for name, (kind, shape) in nodes.items():
        sides = ",".join(str(side) if isinstance(side, int) else "?" for side in shape)
        texts.append(f"{name} {kind.removeprefix('tensor(').removesuffix(')')}[{sides}]")
    return " and ".join(texts) or "none"


def first_line(error: Exception) -> str:
    """What a foreign package says, cut short."""
    text = (str(error).strip() or type(error).__name__).splitlines()[0]
    return text if len(text) <= 200 else f"{text[:200]}..."


def check_size(file: Path) -> None:
    """A file with something in it, of a size that a model may have. Raises InputError."""
    try:
        size = file.stat().st_size
    except OSError as error:
        raise InputError(f"{file}: the model's file cannot be read ({error.strerror})") from None
    if not file.is_file() or not 0 < size <= LARGEST:
        raise InputError(f"{file}: {size} bytes; expected a model file of at most {LARGEST >> 30} GiB")


def _weights_beside(file: Path) -> list[Path]:
    """The files in which a model says that its tensors lie; each must be a plain name in the model's folder."""
    check_size(file)
    with file.open("rb") as opened, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as data:
        names = {found[2][: found[1][0]].decode() for found in _OUTSIDE.finditer(data)}
    for name in sorted(names):
        if Path(name).name != name:
            raise InputError(f"{file}: wants weights from {name!r}; expected a file in its own folder")
    return [file.with_name(name) for name in sorted(names)]


def digest_of_files(*files: Path) -> str:
    """SHA-256 over the bytes of files, one after the other. Raises InputError."""
    digest = hashlib.sha256()
    for file in files:
        try:
            with file.open("rb") as opened:
                while block := opened.read(1 << 22):
                    digest.update(block)
        except OSError as error:
            raise InputError(
                f"{file}: the model's file cannot be read ({error.strerror}); install openvox again"
            ) from None
    return digest.hexdigest()
