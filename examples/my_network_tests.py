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
def arm(**how):
    """The arm with the servo under test in the place of ours."""
    with testing.network("three_axis", without=["servo"], **how):
        with subprocess.Popen([sys.executable, SERVO], stderr=subprocess.DEVNULL) as servo:
            yield
            servo.send_signal(signal.SIGINT)


def command(*words):
    words = [sys.executable, "-m", "arm_emulator", *map(str, words), "--json"]
    return json.loads(subprocess.run(words, stdout=subprocess.PIPE, check=True).stdout)


def test_the_tool_comes_to_its_target(tmp_path):
    with arm(log=tmp_path):
        done = command("move", "--to", 0.43, 0.05, 0.64)
        assert done["states"] == ["accepted", "moving", "reached"] and done["distance"] < 1e-3  # m


def test_what_was_recorded_is_what_the_machine_does(tmp_path):
    with arm(log=tmp_path, record=tmp_path / "bag"):
        command("move", "--by", 0.05, 0, 0)
    assert command("check-bag", tmp_path / "bag")["equal"]
