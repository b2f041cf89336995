"""Children of a run that are killed: how soon the run goes on, and what stays.

`python -m bench.child_kills --count 200`: a plant with a page, a recorder, or a recorder for Rerun
is driven; its child gets SIGKILL, SIGTERM or SIGSTOP, or the run itself SIGKILL, at a random tick.
Each line has the longest wait of the run, and of the child's end; the last line the worst of all.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from arm_emulator.base.process import is_running, list_descendants

CHILDREN = ("page", "recorder", "viewer")
HOW = {"SIGKILL": signal.SIGKILL, "SIGTERM": signal.SIGTERM, "of the run": None}
PATIENCE = 60.0  # s, wall: then it hangs
RUN = """
import signal
import sys
from pathlib import Path
import numpy as np
from arm_emulator import Plant
from arm_emulator.base.run_outputs import NOTHING, RunOutputs
from arm_emulator.base.refusal import Refusal
from arm_emulator.page.control_server import serve_controls
from arm_emulator.runs.recorder import Recorder
child, folder = sys.argv[1:]
signal.signal(signal.SIGINT, signal.default_int_handler)  # what a script begins with & ignores it
kept = {"page": NOTHING, "recorder": RunOutputs(record=Path(folder, "a.mcap")),
        "viewer": RunOutputs(rerun=folder + "/a.rrd")}[child]
plant, port = Plant("three_axis"), "0" if child == "page" else None
try:
    with Recorder(plant, kept, waits=True), serve_controls(plant, port) as server:
        print("ready", flush=True)
        while not sys.stdin.closed and server.poll_requests():
            for _ in range(20):
                plant.exchange(np.zeros(3))
            print("tick", flush=True)
except (Refusal, KeyboardInterrupt) as end:
    print("refused", end, flush=True)
"""


class KillCase:
    """A run with one child, which gets a signal.

    Attributes:
        wait: longest time between two ticks after it [s].
        end: time until the run and the child have ended, the run by Ctrl-C [s].
        left: children that stay.
    """

    def __init__(self, child: str, how: signal.Signals | None, pause: float, folder: Path) -> None:
        command = [sys.executable, "-c", RUN, child, str(folder)]
        self.wait = self.end = 0.0
        with subprocess.Popen(
            command,
            bufsize=0,
            stdout=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        ) as run:
            assert run.stdout is not None
            first = run.stdout.readline()
            while first and b"ready" not in first:  # the page's address comes before it
                first = run.stdout.readline()
            assert first, "it does not start"
            children = list(list_descendants(run.pid))
            time.sleep(pause)
            late = threading.Timer(PATIENCE, run.kill)  # the time shows that it hung
            late.start()
            if how is None:
                run.kill()
                begun = time.monotonic()
            else:
                for pid in children:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, how)
                self.wait = self._watch_run(run)
                begun = time.monotonic()
                run.send_signal(signal.SIGINT)
            while run.stdout.read(65536):
                pass
            run.wait()
            late.cancel()
            while any(map(is_running, children)) and time.monotonic() - begun < PATIENCE:
                time.sleep(0.01)
            self.end = time.monotonic() - begun
            self.left = [pid for pid in children if is_running(pid)]
        for pid in self.left:
            os.kill(pid, signal.SIGKILL)

    @staticmethod
    def _watch_run(run: subprocess.Popen[bytes]) -> float:
        """Return the longest time between two outputs of a run over the next 0.3 s."""
        assert run.stdout is not None
        begun = last = time.monotonic()
        longest = 0.0
        while last - begun < 0.3 and run.stdout.read(65536):
            now = time.monotonic()
            longest, last = max(longest, now - last), now
        return longest


def main() -> None:
    """Print a line for each case, and the worst of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng, cases = np.random.default_rng(options.seed), list[KillCase]()
    for k in range(options.count):
        child, how = CHILDREN[k % 3], list(HOW)[k // 3 % 3]
        with tempfile.TemporaryDirectory() as folder:
            case = KillCase(child, HOW[how], float(rng.uniform(0.0, 0.5)), Path(folder))
        cases.append(case)
        print(f"{k:4d} {child:<9} {how:<10} wait {case.wait:.2f} s, end {case.end:.2f} s, "
              f"left {len(case.left)}", flush=True)  # fmt: skip
    print(f"{len(cases)} cases: wait {max(killed.wait for killed in cases):.2f} s, "
          f"end {max(killed.end for killed in cases):.2f} s, "
          f"left {sum(len(killed.left) for killed in cases)}")  # fmt: skip


if __name__ == "__main__":
    main()
