"""The bundled recording gives the same map and trace, bit by bit, however and wherever it is replayed."""

from __future__ import annotations

import importlib.util
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


@pytest.mark.parametrize("preset", ["openvox", "official", "paper"])
def test_the_bundled_recording_gives_the_golden_map_and_trace(tmp_path: Path, preset: str) -> None:
    assert replayed(tmp_path, "--preset", preset) == GOLDEN[preset]


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch; tools/test --torch")
@pytest.mark.parametrize("preset", ["openvox", "official", "paper"])
def test_the_torch_engine_gives_the_golden_map_and_trace(tmp_path: Path, preset: str) -> None:
    assert replayed(tmp_path, "--preset", preset, "--engine", "torch") == GOLDEN[preset]


def test_neither_hash_seed_nor_threads_nor_watching_changes_a_bit(tmp_path: Path) -> None:
    watched = replayed(
        tmp_path, "--rerun", str(tmp_path / "run.rrd"), PYTHONHASHSEED="7", NUMBA_NUM_THREADS="1", OMP_NUM_THREADS="1"
    )
    assert watched == GOLDEN["openvox"]


def test_without_a_folder_for_compiled_kernels_the_run_says_so_and_gives_the_same(tmp_path: Path) -> None:
    source = "import numba.core.caching as c; c.CacheImpl._locator_classes = []; from openvox.cli import main; main()"
    command = ["replay", str(RECORDING), "--end", "4", "--out", str(tmp_path / "run"), "--json"]
    done = subprocess.run([sys.executable, "-c", source, *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "no folder to keep the compiled kernels in" in done.stderr
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout)["digests"] == replayed(tmp_path, "--end", "4")


def test_other_parameters_give_another_map(tmp_path: Path) -> None:
    assert replayed(tmp_path, "--set", "map.voxel_size=0.08")["map"] != GOLDEN["openvox"]["map"]
