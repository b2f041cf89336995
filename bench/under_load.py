"""A command, many times, beside busy processes: does it hold?

python -m bench.under_load [--busy 8] [--repeat 20] -- pytest test/nodes/test_network.py
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from rich.console import Console

from arm_emulator.base.cpu_load import load_processors

LOGS = Path("log/under_load")


def main() -> None:
    """Print a line per repetition and the count; exit code 1 if any failed."""
    parser = argparse.ArgumentParser(prog="bench.under_load", description=__doc__.splitlines()[0])
    parser.add_argument("--busy", type=int, default=8, help="busy processes beside it")
    parser.add_argument("--repeat", type=int, default=20)
    parser.add_argument("command", nargs="+", help="after --: what to repeat")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # leave nothing behind then, too
    console = Console(highlight=False)
    LOGS.mkdir(parents=True, exist_ok=True)
    failed = 0
    with load_processors(arguments.busy):
        console.print(f"{'run':>4} {'exit':>5} {'seconds':>8} {'load':>6}  last words")
        for run in range(1, arguments.repeat + 1):
            log = LOGS / f"{run}.log"
            started = time.monotonic()
            with log.open("w") as out:
                done = subprocess.run(
                    arguments.command, stdout=out, stderr=subprocess.STDOUT, check=False
                )
            seconds, load = time.monotonic() - started, os.getloadavg()[0]
            words = (log.read_text(errors="replace").splitlines() or [""])[-1].strip("= ")
            failed += done.returncode != 0
            line = f"{run:4} {done.returncode:5} {seconds:8.1f} {load:6.1f}  {words}"
            console.print(line, style="red" if done.returncode else None, markup=False)
    console.print(f"{arguments.repeat - failed} of {arguments.repeat} passed, logs in {LOGS}/")
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
