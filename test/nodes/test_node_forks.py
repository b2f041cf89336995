"""Nodes that are forked: their ends, their outputs, their process's end, and times of their own."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from arm_emulator.base.process import is_running
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import own_domain

PATIENCE = 60.0  # s, wall: for what takes some ms on an idle machine

USER = """
import signal, sys
from arm_emulator.ros.process.bringup import NODES, Bringup
from arm_emulator.ros.process.ros_domain import own_domain
with own_domain(), Bringup("three_axis", forked=True) as nodes:
    print(*[nodes.get_process(name).pid for name in NODES], flush=True)
    signal.pause()
"""


def test_nodes_end_with_the_user_who_is_killed() -> None:
    user = subprocess.Popen([sys.executable, "-c", USER], stdout=subprocess.PIPE, text=True)
    assert user.stdout is not None
    with user.stdout:
        nodes = [int(word) for word in user.stdout.readline().split()]
    assert len(nodes) == 3 and all(map(is_running, nodes))
    user.kill()
    user.wait()
    deadline = time.monotonic() + PATIENCE
    while any(map(is_running, nodes)):
        assert time.monotonic() < deadline, f"{nodes} still run"
        time.sleep(0.01)


def test_each_end_is_reported_and_the_next_network_is_of_new_processes(tmp_path: Path) -> None:
    words = ("three_axis",)
    with own_domain():
        with Bringup(*words, log=tmp_path, forked=True) as first:
            killed = first.get_process("servo")
            assert killed.poll() is None
            with pytest.raises(subprocess.TimeoutExpired):
                killed.wait(0.0)
            killed.send_signal(signal.SIGKILL)
            assert killed.wait(PATIENCE) == -signal.SIGKILL
            assert first.find_ended() == ("servo", -signal.SIGKILL)
            killed.send_signal(signal.SIGINT)  # it has ended: nobody gets it
            codes = first.stop_nodes()
            assert codes == {"emulator": 0, "servo": -signal.SIGKILL, "motion_controller": 0}
        refused = {"real_time_factor": -1.0}
        with Bringup(
            *words, emulator=refused, log=tmp_path, forked=True, only=("emulator",)
        ) as two:
            second = two.get_process("emulator")
            assert second.wait(PATIENCE) == 2
        assert "real_time_factor" in (tmp_path / "emulator.log").read_text()
        assert second.pid != killed.pid and os.getpid() not in (second.pid, killed.pid)
