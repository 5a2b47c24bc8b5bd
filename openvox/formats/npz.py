"""Plain numpy arrays in a .npz file: written with the same bytes everywhere, read without trusting a size.

Members are stored, not packed: packed bytes differ between versions of zlib, and the same arrays must give the same
file on every machine. Packed members of other writers are read, too.
"""

from __future__ import annotations

import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from openvox.core.errors import InputError

MAX_MEMBERS = 10_000
MAX_GROWTH = 200
"""Times the file's size that its arrays may take in memory: packed numbers shrink less, a zip bomb more."""
FREE_BYTES = 1 << 24
"""May be unpacked whatever the file's size: small arrays of equal numbers shrink a thousandfold."""

_BROKEN = (
    *(zipfile.BadZipFile, zlib.error, struct.error, EOFError, RuntimeError, MemoryError),
    *(SyntaxError, tokenize.TokenError, TypeError, ValueError, OverflowError),  # of an array's header
)
Axis = int | str
"""A number, or a name: all axes of the same name are equally long."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays in their order under their names. Raises OSError; see `partial_file`."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:  # dated 1980 whatever the clock says
                npy.write_array(member, np.ascontiguousarray(array), version=(1, 0), allow_pickle=False)


def read_arrays(path: Path, wanted: Callable[[str], bool]) -> dict[str, NDArray[Any]]:
    """The arrays whose names are wanted, in the file's order; numbers and truth values only.

    Every size is held against the file before anything is allocated, every CRC is checked. Raises InputError."""
    with _opened(path) as archive:
        members = archive.infolist()
        names = [member.filename.removesuffix(".npy") for member in members]
        if len(members) > MAX_MEMBERS or len(set(names)) != len(names):
            raise InputError(f"{path} holds {len(names)} arrays, some of the same name; expected a few, each once")
        chosen = [(name, member) for name, member in zip(names, members, strict=True) if wanted(name)]
        total, limit = sum(member.file_size for _, member in chosen), MAX_GROWTH * path.stat().st_size + FREE_BYTES
        if total > limit:
            raise InputError(f"{path} would unpack to {total} bytes, more than the {limit} that its size can mean")
        return {name: _array(path, archive, name, member) for name, member in chosen}


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The archive, and whatever reading broken bytes can raise as one InputError."""
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except _BROKEN as error:
        raise InputError(
            f"{path} is no whole .npz file ({error or type(error).__name__}); expected a map made by openvox replay"
        ) from error
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error}); expected an .npz file") from error


def _array(path: Path, archive: zipfile.ZipFile, name: str, member: zipfile.ZipInfo) -> NDArray[Any]:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(f"{path}: array {name} is packed by method {member.compress_type}; save it with numpy.savez")
    with archive.open(member) as file:
        version = npy.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            raise InputError(f"{path}: array {name} has npy version {version}; expected 1.0 or 2.0")
        header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = header(file)
        if dtype.kind not in "biuf" or dtype.subdtype is not None:
            raise InputError(f"{path}: array {name} holds {dtype}; expected plain numbers")
        size = math.prod(shape) * dtype.itemsize
        if min(shape, default=0) < 0 or size != member.file_size - file.tell():
            raise InputError(
                f"{path}: array {name} states shape {shape} of {dtype}, but {member.file_size - file.tell()} bytes "
                f"follow; make the file anew"
            )
        data = file.read(size + 1)  # one more than is there: reading to the end checks the CRC
    if len(data) != size:
        raise EOFError(f"array {name} ends early")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def check_layout(
    path: Path, arrays: Mapping[str, NDArray[Any]], layout: Mapping[str, tuple[str, Sequence[Axis]]]
) -> dict[str, int]:
    """Hold arrays against a table of name to (dtype, axes); the lengths of the named axes. Raises InputError."""
    lengths: dict[str, int] = {}
    for name, (dtype, axes) in layout.items():
        if name not in arrays:
            raise InputError(f"{path} has no array {name}; expected {', '.join(layout)}")
        array = arrays[name]
        if array.dtype != np.dtype(dtype) or array.ndim != len(axes):
            raise InputError(
                f"{path}: array {name} is {array.dtype} of shape {array.shape}; "
                f"expected {np.dtype(dtype)} with {len(axes)} axes"
            )
        for axis, length in zip(axes, array.shape, strict=True):
            expected = lengths.setdefault(axis, length) if isinstance(axis, str) else axis
            if length != expected:
                raise InputError(
                    f"{path}: array {name} has shape {array.shape}; expected {expected} in place of {length}, "
                    "as the other arrays have it"
                )
    return lengths
