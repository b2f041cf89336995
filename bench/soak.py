"""Ten minutes of real time with a busy core beside it: `python -m bench.soak [--minutes 10]`."""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time

from rich.console import Console
from rich.progress import Progress

from arm_emulator.ros.ros_domain import own_domain
from bench.busy import busy_processes
from bench.clocks import FACTOR_ERROR, OLD_SHARE, measure, punctual


def main() -> None:
    """Run the three nodes, then print how punctual they were; exit code 1 if they were not."""
    parser = argparse.ArgumentParser(prog="bench.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--scene", default="three_axis")
    arguments = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    seconds = 60.0 * arguments.minutes
    console = Console()
    with own_domain(unless_named=True), busy_processes(1), Progress(console=console) as progress:
        bar = progress.add_task("real time, one core busy", total=seconds)
        over = threading.Event()
        started = time.monotonic()

        def show() -> None:
            while not over.wait(1.0):
                progress.update(bar, completed=time.monotonic() - started)

        clock = threading.Thread(target=show)
        clock.start()
        try:
            figures = measure("real_time", arguments.scene, seconds)
        finally:
            over.set()
            clock.join()
    for name, value in figures.items():
        console.print(f"{name:<20} {value}")
    met = punctual(figures)
    limits = f"{FACTOR_ERROR:.1%} and {OLD_SHARE:.0%} are the limits"
    console.print("punctual" if met else f"[red]not punctual: {limits}")
    sys.exit(not met)


if __name__ == "__main__":
    main()
