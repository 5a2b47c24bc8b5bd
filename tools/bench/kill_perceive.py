"""Kills `openvox perceive` at random moments and checks that it goes on to the bytes of a run that was left alone.

    python tools/bench/kill_perceive.py REC.mcap [--kills 50] [--seed 0] [-- --frontend geometry --end 60]

What stands behind `--` goes to every run. Nothing is written beside the recording.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main() -> None:
    words = sys.argv[1:]
    cut = words.index("--") if "--" in words else len(words)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(words[:cut])
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "openvox", "perceive", str(options.recording), *words[cut + 1 :], "--json"]
        whole, out = Path(folder) / "whole.mcap", Path(folder) / "killed.mcap"
        began = time.monotonic()
        subprocess.run([*command, "--out", str(whole)], check=True, stdout=subprocess.DEVNULL)
        report = killed([*command, "--out", str(out)], out, whole.read_bytes(), time.monotonic() - began, options)
    print(json.dumps(report))


def killed(
    command: list[str], out: Path, expected: bytes, seconds: float, options: argparse.Namespace
) -> dict[str, float]:
    """Kills until there were enough, letting finish what finishes; the last run is left alone."""
    chance = random.Random(options.seed)
    kills = ends = with_rest = reused = 0
    while True:
        left_alone = kills >= options.kills
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        try:
            text, _ = process.communicate(timeout=None if left_alone else chance.uniform(0, seconds))
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            kills += 1
            with_rest += any(out.parent.glob("*.partial"))
            if out.exists() and out.read_bytes() != expected:
                sys.exit(f"after kill {kills} {out.name} is there, and is not what it should be")
            continue
        if process.returncode or out.read_bytes() != expected:
            sys.exit(f"after {kills} kills the result is not that of a run that was left alone: {text}")
        if any(out.parent.glob("*.partial")):
            sys.exit(f"after {kills} kills a finished run has left something behind")
        ends, reused = ends + 1, reused + json.loads(text)["reused"]
        if left_alone:
            return {"kills": kills, "with_a_rest": with_rest, "finished": ends, "frames_reused": reused,
                    "seconds_of_a_run": round(seconds, 1)}  # fmt: skip
        out.unlink()


main()
