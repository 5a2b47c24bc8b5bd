"""recover: what is whole in a broken recording, perception or trace, as a file of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from openvox.core.errors import InputError
from openvox.formats.recover import salvage
from openvox.formats.recover_kinds import write_anew


@dataclass(frozen=True)
class RecoverResult:
    """What was saved."""

    output: str
    replaced: bool
    """An older file of that name was replaced."""
    kind: str
    """recording, perception or trace."""
    digest: str
    """The chain over the frames that were kept."""
    kept: Mapping[str, int]
    """Topic to number of messages."""
    lost: tuple[Mapping[str, Any], ...]
    """topic, from, to, reason: messages after one stamp and before another, nanoseconds; null where nothing whole
    stands before, or after."""


def recover(broken: Path, out: Path) -> RecoverResult:
    """Writes every whole frame of `broken` to `out`, which appears complete or not at all.

    broken: cut off, damaged, or a .partial. Raises InputError if nothing can be saved, OutputError."""
    if not broken.is_file():
        raise InputError(f"{broken} is {'a folder' if broken.is_dir() else 'not there'}; expected a broken MCAP file")
    if broken.resolve() in (out.resolve(), out.with_name(out.name + ".partial").resolve()):
        raise InputError(f"{out} would be written over {broken}; name another file")
    replaced = out.exists()
    kind, ledger = write_anew(salvage(broken), out)
    return RecoverResult(
        output=str(out),
        replaced=replaced,
        kind=kind,
        digest=ledger.digest,
        kept=dict(sorted(ledger.kept.items())),
        lost=tuple(
            {"topic": loss.topic, "from": loss.after, "to": loss.before, "reason": loss.reason} for loss in ledger.lost
        ),
    )
