"""Tests of a servo node in a lock-step network: ``pytest examples/my_network_tests.py``."""

import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from arm_emulator import testing

SERVO = Path(__file__).with_name("my_servo.py")
TARGET = 0.43, 0.05, 0.64  # m, of the tool


@contextmanager
def servo_in_place_of_ours(folder):
    """Run the network with the servo under test; the bag of a failure stays in the folder."""
    how = {"without": ["servo"], "log": folder, "keep": folder / "bag", "start": "paused"}
    with testing.network("three_axis", **how) as net:
        with subprocess.Popen([sys.executable, SERVO]) as servo:
            yield net
            servo.send_signal(signal.SIGINT)


def test_the_tool_comes_to_its_target_and_stays_when_the_power_is_cut(tmp_path):
    with servo_in_place_of_ours(tmp_path) as net:
        target = net.send_tool_target(TARGET, at=0.2)  # acknowledged while time stands at tick 0
        net.go_on()
        net.wait_for(target, "reached")
        net.wait_until(2.5)  # s, of logical time
        there = np.array(net.truth.position)
        net.power(False)
        net.wait_until(net.time + 0.5)
        assert np.abs(np.array(net.truth.position) - there).max() < 0.02  # rad
