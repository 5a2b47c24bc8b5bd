"""What 1, 10 and 100 parameter sets cost, and what it costs to find them done: a table in Markdown.

python tools/bench/sweep.py living.mcap --truth scans/living --end 40
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

TENTHS = "0.05,0.1,0.2,0.3,0.4,0.5,0.6,0.7,0.8,0.9"
SETS = {
    1: ["association.threshold=0.4"],
    10: [f"association.threshold={TENTHS}"],
    100: [f"association.threshold={TENTHS}", f"association.weight_geometry={TENTHS}"],
}
"""Each holds the default."""


def timed(words: list[str]) -> tuple[float, dict[str, Any]]:
    begin = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "openvox", *words], check=True, capture_output=True, text=True)
    return time.perf_counter() - begin, json.loads(done.stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--counts", type=int, nargs="+", default=list(SETS), choices=list(SETS))
    own, passed = parser.parse_known_args()
    print("| sets | at a time | seconds | a set | again | bytes a set |\n|---|---|---|---|---|---|")
    for count in own.counts:
        with tempfile.TemporaryDirectory() as folder:
            words = ["sweep", str(own.recording), *passed, "--out", f"{folder}/out", "--json"]
            words += [word for text in SETS[count] for word in ("--set", text)]
            seconds, found = timed(words)
            again, _ = timed(words)
            size = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
            assert len(found["items"]) == count, len(found["items"])
            row = (count, found["jobs"], f"{seconds:.1f}", f"{seconds / count:.2f}", f"{again:.1f}", size // count)
            print("| " + " | ".join(map(str, row)) + " |", flush=True)


if __name__ == "__main__":
    main()
