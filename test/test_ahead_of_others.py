"""Real-time priority of the threads of a node: all of Python, and those of the middleware."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from arm_emulator.cli.commands.doctor import findings

SCRIPT = """
import os, threading, rclpy
from pathlib import Path
from arm_emulator.ros.ahead_of_others import go_ahead_of_others

rclpy.init()
node = rclpy.create_node("one")
end = threading.Event()
for name in ("taker", "other"):
    threading.Thread(target=end.wait, name=name).start()
granted = go_ahead_of_others()
flag = os.SCHED_RESET_ON_FORK
first = {one.name: os.sched_getscheduler(one.native_id) & ~flag for one in threading.enumerate()}
tasks = [one for one in Path("/proc/self/task").iterdir()]
dds = {os.sched_getscheduler(int(one.name)) & ~flag for one in tasks
       if (one / "comm").read_text().startswith("dds.")}
end.set()
print(granted, first["MainThread"], first["taker"], first["other"], *dds)
os._exit(0)
"""


def permitted() -> bool:
    words = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))"
    return (
        subprocess.run(
            [sys.executable, "-c", words], stderr=subprocess.DEVNULL, check=False
        ).returncode
        == 0
    )


def test_messages_go_ahead_of_other_processes() -> None:
    if not permitted():
        pytest.skip("the system permits no SCHED_FIFO")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    fifo = os.SCHED_FIFO
    assert done.stdout.split() == ["True", *map(str, (fifo, fifo, fifo, fifo))], done.stdout


def test_doctor_reports_wake_ups_that_are_later_than_a_period(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not permitted():
        pytest.skip("the system permits no SCHED_FIFO")
    for late, level in ((2e-4, "ok"), (3e-3, "note")):
        now = 0.0

        def sleep(seconds: float, late: float = late) -> None:
            nonlocal now
            now += seconds + late

        clock = SimpleNamespace(monotonic=lambda: now, sleep=sleep)  # noqa: B023
        monkeypatch.setattr("arm_emulator.cli.commands.doctor.time", clock)
        (found,) = (one for one in findings() if one.name == "priority")
        assert found.level == level and f"{late * 1e6:.0f} us at worst" in found.text, found
