"""The bundled recording gives the same map and trace, bit by bit, however and wherever it is replayed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
RECORDING = ROOT / "recordings" / "living_demo.mcap"
GOLDEN = json.loads((ROOT / "tests" / "golden.json").read_text())


def replayed(folder: Path, *options: str, **environment: str) -> dict[str, str]:
    """Digests of a replay in a fresh process."""
    command = [sys.executable, "-m", "openvox", "replay", str(RECORDING), "--out", str(folder / "run"), "--json"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr
    digests: dict[str, str] = json.loads(done.stdout)["digests"]
    return digests


@pytest.mark.parametrize("preset", ["openvox", "paper"])
def test_the_bundled_recording_gives_the_golden_map_and_trace(tmp_path: Path, preset: str) -> None:
    assert replayed(tmp_path, "--preset", preset) == GOLDEN[preset]


def test_neither_hash_seed_nor_threads_nor_watching_changes_a_bit(tmp_path: Path) -> None:
    watched = replayed(
        tmp_path, "--rerun", str(tmp_path / "run.rrd"), PYTHONHASHSEED="7", NUMBA_NUM_THREADS="1", OMP_NUM_THREADS="1"
    )
    assert watched == GOLDEN["openvox"]


def test_other_parameters_give_another_map(tmp_path: Path) -> None:
    assert replayed(tmp_path, "--set", "map.voxel_size=0.08")["map"] != GOLDEN["openvox"]["map"]
