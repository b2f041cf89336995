"""Runs of the fixture `arm_emulator.testing.network` beside busy processes: failures, and bits.

    python -m bench.fixture_runs --runs 1000 --busy 8

Each run starts a network of three processes, sends two targets with logical times before tick 0,
and compares counts and currents of each tick up to the last one with those of the first run.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from rclpy.serialization import deserialize_message

from arm_emulator import testing
from arm_emulator.base.busy import busy_processes
from arm_emulator.ros.bag import Bag
from arm_emulator_msgs.msg import MotorState

SECONDS = 1.5  # logical
TARGETS = ((0.43, 0.05, 0.64), (0.43, -0.05, 0.64))  # m, at 0.2 s and 0.8 s


def main() -> int:
    """Run, and print a line for each failure and each sequence that is new, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--busy", type=int, default=8, help="busy processes beside")
    parser.add_argument("--minutes", type=float, default=1e9, help="no new run after")
    given = parser.parse_args()
    digests: dict[str, int] = {}
    took: list[float] = []
    ready: list[float] = []
    failures, begin = 0, time.monotonic()
    with busy_processes(given.busy):
        while len(took) < given.runs and time.monotonic() - begin < 60.0 * given.minutes:
            started = time.monotonic()
            try:
                with tempfile.TemporaryDirectory() as folder:
                    digest = _one_run(Path(folder), ready)
                if digest not in digests:
                    print(f"run {len(took)}: sequence {digest[:16]}", flush=True)
                digests[digest] = digests.get(digest, 0) + 1
            except AssertionError as error:
                failures += 1
                print(f"run {len(took)}: {error}", flush=True)
            took.append(time.monotonic() - started)
    of_ready = f"{median(ready):.1f} s until a target is acknowledged"
    print(
        f"{len(took)} runs beside {given.busy} busy processes: {failures} failures, "
        f"{len(digests)} different sequences of {round(SECONDS * 1e3)} states; median "
        f"{median(took):.1f} s a run, of which {of_ready}, "
        f"longest {max(took):.1f} s"
    )
    return 1 if failures or len(digests) != 1 else 0


def _one_run(folder: Path, ready: list[float]) -> str:
    """Return the digest of a run's states."""
    bag, started = folder / "bag", time.monotonic()
    with testing.network("three_axis", start="paused", log=folder, record=bag) as net:
        numbers = [net.send_tool_target(TARGETS[0], at=0.2)]
        ready.append(time.monotonic() - started)
        numbers.append(net.send_tool_target(TARGETS[1], at=0.8))
        net.go_on()
        net.wait_for(numbers[1])
        net.wait_until(SECONDS)
    digest, ticks = hashlib.sha256(), 0
    for message in Bag(bag).messages(["/motor_states"]):
        state = deserialize_message(message.data, MotorState)
        if state.tick == ticks <= SECONDS * 1e3:
            digest.update(state.encoder_counts.tobytes() + state.current.tobytes())
            ticks += 1
    assert ticks > SECONDS * 1e3, f"{ticks} states"
    return digest.hexdigest()


if __name__ == "__main__":
    sys.exit(main())
