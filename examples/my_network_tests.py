"""Tests of a servo node in a lock-step network: ``pytest examples/my_network_tests.py``."""

import json
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from arm_emulator import testing

SERVO = Path(__file__).with_name("my_servo.py")


@contextmanager
def servo_in_place_of_ours(folder):
    """Run the network with the servo under test; its log and a bag are in the folder."""
    how = {"without": ["servo"], "log": folder, "record": folder / "bag"}
    with testing.network("three_axis", **how), subprocess.Popen([sys.executable, SERVO]) as servo:
        yield
        servo.send_signal(signal.SIGINT)


def command(*words):
    """Return what a command of arm_emulator reports."""
    line = [sys.executable, "-m", "arm_emulator", *map(str, words), "--json"]
    return json.loads(subprocess.run(line, stdout=subprocess.PIPE, check=True).stdout)


def test_the_tool_comes_to_its_target_and_every_bit_can_be_computed_again(tmp_path):
    with servo_in_place_of_ours(tmp_path):
        done = command("move", "--to", 0.43, 0.05, 0.64)
    assert done["states"] == ["accepted", "moving", "reached"] and done["distance"] < 1e-3  # m
    assert command("check-bag", tmp_path / "bag")["equal"]
