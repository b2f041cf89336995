"""Recordings in lock-step beside busy processes: is every tick in every bag, and `check-bag` equal?

python -m bench.recordings [--count 20] [--seconds 20] [--busy 4]

Each run is recorded in one of two ways: by `record`, started just before `up`, or by the emulator
itself, `up --record`. The arm moves meanwhile. Exit code 1 if a tick is missing anywhere.
"""

from __future__ import annotations

import argparse
import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rich.console import Console

from arm_emulator.ros.bag import Bag
from arm_emulator.ros.node_shell import STATE_SUB_QOS
from arm_emulator.ros.ros_domain import own_domain
from arm_emulator_msgs.msg import EmulatorStatus, MotorState
from bench.busy import busy_processes

WAYS = ("record", "up --record")
TARGETS = ((0.10, 0.02, 0.80), (0.08, -0.02, 0.78))  # m, of three_axis, by turns
TARGET_PERIOD = 1.0  # s, wall
LONGEST = 1800.0  # s, wall: for one recording
ENDING = 60.0  # s, wall


@dataclass
class Outcome:
    """What became of one recording."""

    way: str
    wall: float  # s
    ticks: int  # the last one in the bag
    missing: int
    codes: tuple[int, ...]  # of recorder and network
    check: str  # its last line
    closing: str  # the last line of what recorded

    @property
    def good(self) -> bool:
        """Whether every tick is there, and equal."""
        return not self.missing and not any(self.codes) and self.check == "equal to the last bit"


def command(*arguments: object) -> list[str]:
    """Return a command of `arm_emulator`."""
    return [sys.executable, "-m", "arm_emulator", *map(str, arguments)]


@contextmanager
def process(arguments: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command with its words in a file."""
    with log.open("wb") as out:
        one = subprocess.Popen(arguments, stdout=out, stderr=subprocess.STDOUT)
    try:
        yield one
    finally:
        if one.poll() is None:
            one.send_signal(signal.SIGINT)
            one.wait(ENDING)


def end(one: subprocess.Popen[bytes]) -> int:
    """Stop a process as Ctrl-C does and return its exit code."""
    one.send_signal(signal.SIGINT)
    return one.wait(ENDING)


def run_until(domain: int, seconds: float, network: subprocess.Popen[bytes]) -> None:
    """Move the arm until logical time has come to `seconds` [s]."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("bench", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    reached = 0.0

    def on_status(status: EmulatorStatus) -> None:
        nonlocal reached
        reached = status.logical_time

    node.create_subscription(EmulatorStatus, "emulator/status", on_status, STATE_SUB_QOS)
    targets = node.create_publisher(PoseStamped, "tool_target", QoSProfile(depth=10))
    message = PoseStamped()
    message.pose.orientation.w = 1.0
    position, turns = message.pose.position, itertools.cycle(TARGETS)
    next_target, deadline = 0.0, time.monotonic() + LONGEST
    try:
        while reached < seconds and network.poll() is None and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.2)
            if time.monotonic() > next_target:
                next_target = time.monotonic() + TARGET_PERIOD
                position.x, position.y, position.z = next(turns)
                targets.publish(message)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def one_recording(way: str, seconds: float, folder: Path) -> Outcome:
    """Record one run and count its ticks."""
    bag, started = folder / "bag", time.monotonic()
    up_log, record_log = folder / "up.log", folder / "record.log"
    codes: list[int] = []
    with own_domain() as domain, ExitStack() as running:
        if way == "record":
            recorder = running.enter_context(process(command("record", bag), record_log))
            up = running.enter_context(process(command("up", "three_axis"), up_log))
        else:
            up = running.enter_context(
                process(command("up", "three_axis", "--record", bag), up_log)
            )
        run_until(domain, seconds, up)
        if way == "record":
            codes.append(end(recorder))
        codes.append(end(up))
    log = record_log if way == "record" else up_log
    closing = next(
        (s for s in reversed(log.read_text().splitlines()) if " messages" in s), "nothing"
    )
    ticks = [
        int(deserialize_message(m.data, MotorState).tick)
        for m in Bag(bag).messages(["/motor_states"])
    ]
    last = max(ticks, default=-1)
    # Not only what lies between: the run must begin at tick 0 and come to its end.
    missing = len(set(range(max(last, round(seconds * 1000)) + 1)) - set(ticks))
    checked = subprocess.run(command("check-bag", bag), capture_output=True, text=True, check=False)
    words = (checked.stdout + checked.stderr).strip().splitlines() or ["nothing"]
    return Outcome(way, time.monotonic() - started, last, missing, tuple(codes), words[-1], closing)


def main() -> None:
    """Print a line per recording and what came of all."""
    parser = argparse.ArgumentParser(prog="bench.recordings", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="recordings of each way")
    parser.add_argument("--seconds", type=float, default=20.0, help="logical time of each")
    parser.add_argument("--busy", type=int, default=4, help="busy processes beside them")
    parser.add_argument("--out", type=Path, default=Path("out/recordings"), help="bags and logs")
    parser.add_argument("--keep", action="store_true", help="keep the bags that are in order, too")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # leave nothing behind then, too
    console = Console(highlight=False)
    outcomes: list[Outcome] = []
    console.print(f"{'way':<12} {'run':>4} {'wall s':>7} {'load':>5} {'ticks':>7} {'missing':>8}  "
                  "exit codes, check")  # fmt: skip
    with busy_processes(arguments.busy):
        for way, run in itertools.product(WAYS, range(1, arguments.count + 1)):
            folder = arguments.out / f"{way.split()[0]}_{run}"
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            one = one_recording(way, arguments.seconds, folder)
            outcomes.append(one)
            console.print(
                f"{way:<12} {run:4} {one.wall:7.1f} {os.getloadavg()[0]:5.1f} {one.ticks:7} "
                f"{one.missing:8}  {one.codes}, {one.check}",
                style=None if one.good else "red",
                markup=False,
            )
            if not one.good:
                console.print(f"    {one.closing}; logs in {folder}", style="red", markup=False)
            elif not arguments.keep:
                shutil.rmtree(folder)
    for way in WAYS:
        those = [one for one in outcomes if one.way == way]
        ticks = sum(one.ticks + 1 for one in those)
        console.print(
            f"{way}: {sum(one.good for one in those)} of {len(those)} recordings complete, equal, "
            f"{sum(one.missing for one in those)} of {ticks} ticks missing",
            markup=False,
        )
    sys.exit(not all(one.good for one in outcomes))


if __name__ == "__main__":
    main()
