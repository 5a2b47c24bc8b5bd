"""Kill a live run at random moments (kill -9), and look at what is left.

    python tools/bench/live_crashes.py recordings/living_demo.mcap --kills 50 --rate 2

For every kill: what was lost of the frames that had been mapped (pictures or masks), in seconds of sensor time; whether
the rest is the beginning of the recording, to the bit; and whether replay makes a map of it.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import tempfile
import time
from pathlib import Path

from openvox.apps.live import live
from openvox.apps.replay import replay, warm_up
from openvox.core.digest import START, frame_digest, recording_link
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import PRESETS
from openvox.formats.perception import read_masks
from openvox.formats.recording import read_frames, recording_info


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("recording", type=Path)
    arguments.add_argument("--kills", type=int, default=50)
    arguments.add_argument("--rate", type=float, default=2.0)
    arguments.add_argument("--seconds", type=float, default=4.0, help="a run is killed after 0 to so many seconds")
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_args()
    warm_up(PRESETS["openvox"], "cpu", print)
    links, stamps, numbers, link = [], [], [], START
    for frame in read_frames(given.recording):
        link = recording_link(link, frame_digest(frame), frame)
        links.append(link)
        stamps.append(frame.stamp_ns)
        numbers.append(frame.index)
    chance = random.Random(given.seed)
    lost, kept, empty, replayed = [], [], 0, 0
    for number in range(given.kills):
        with tempfile.TemporaryDirectory() as folder:
            mapped = killed(given.recording, Path(folder) / "run", given.rate, chance.uniform(0, given.seconds))
            partial = Path(folder) / "run.mcap.partial"
            try:
                info = recording_info(partial)
            except InputError:
                empty += 1
                saved = 0
            else:
                saved = info.frames
                assert info.digest == links[saved - 1], "what is left is not the beginning of the recording"
                kept.append(saved)
            looked = seen(Path(folder) / "run.perception.mcap.partial", numbers)
            if saved and looked:
                result = replay(partial)
                assert result["frames"] == saved
                assert result["digests"]["recording"] == links[saved - 1]
                replayed += 1
            saved = min(saved, looked)
            begun = stamps[saved - 1] if saved else stamps[0]
            lost.append(max(0.0, (stamps[mapped - 1] - begun) / 1e9) if mapped else 0.0)
            print(f"kill {number + 1}: {mapped} frames mapped, {saved} saved, {lost[-1]:.2f} s lost", flush=True)
    print(
        f"{given.kills} kills: {len(kept)} left a recording ({min(kept)} to {max(kept)} frames), all the beginning of "
        f"the source; {replayed} had masks, too, and all of these replayed; {empty} had no whole chunk yet; "
        f"lost at most {max(lost):.2f} s, mean {sum(lost) / len(lost):.2f} s"
    )


def seen(perception: Path, numbers: list[int]) -> int:
    """Frames up to the last one whose masks were saved."""
    try:
        return max((numbers.index(found.index) for found in read_masks(perception)), default=-1) + 1
    except InputError:  # its first record is not there yet
        return 0


def killed(recording: Path, out: Path, rate: float, after: float) -> int:
    """Frames that a run had mapped when it was killed."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        live(str(recording), out=str(out), rate=rate, status=lambda status: os.write(writer, b"."))  # type: ignore[arg-type,return-value]
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as steps:
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return len(steps.read())


if __name__ == "__main__":
    main()
