"""How the nodes start, say no, and end: alone and together."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from network import PATIENCE, User

from arm_emulator.config_files import find_config
from arm_emulator.ros_domain import own_domain

SERVO = ("servo_node.node", "--params-file", "config/servo/three_axis.yaml")
# Module and arguments after --ros-args, and what is said.
REFUSED_NODES = [
    (("emulator_node.node", "-p", "scene:=nonesuch"), "arm_emulator: file nonesuch must exist"),
    (("emulator_node.node", "-p", "scene:=3"), "node emulator: parameter scene must be a text"),
    (("emulator_node.node", "-p", "scene:=setup.py"), "setup.py: file must be "),
    (
        ("emulator_node.node", "-p", "clock:=sundial"),
        "node emulator: parameter clock must be known, got 'sundial'; valid: lockstep, realtime",
    ),
    (
        ("emulator_node.node", "-p", "timeout:=-1.0"),
        "node emulator: parameter timeout must be a number from 0.1 to 3600.0, got -1.0",
    ),
    (
        ("emulator_node.node", "-p", "timout:=3.0"),
        "node emulator: parameter timout must be a known one, got an unknown one, "
        "perhaps for timeout; valid: scene, ",
    ),
    (
        ("servo_node.node",),
        "node servo: its parameters must come from a file, got no file; valid: --ros-args "
        "--params-file config/servo/three_axis.yaml",
    ),
    ((*SERVO, "-p", "speed:=3.0"), "parameters of node servo: speed must be a known key"),
    (
        (*SERVO, "-p", "hold_after:=-3.0"),
        "parameters of node servo: hold_after must be a number > 0 s, got -3.0",
    ),
    (
        (*SERVO, "-p", "joints.elbow.resistance:=none"),
        "parameters of node servo: joints.elbow.resistance must be a number > 0 ohm, got 'none'",
    ),
    (
        (*SERVO, "-p", "joints.knee.resistance:=1.0"),
        "parameters of node servo: joints.knee must be a known key",
    ),
    (
        ("motion_controller_node.node", "-p", "weight:=2.0"),
        "node motion_controller: parameter weight must be a number from 1e-06 to 1.0, got 2.0",
    ),
    (
        ("motion_controller_node.node", "-p", "weight:=half"),
        "node motion_controller: parameter weight must be a number from 1e-06 to 1.0, got 'half'",
    ),
]
# What ROS itself does not take; it says a line of its own before.
REFUSED_BY_ROS = [
    (
        ("servo_node.node", "--params-file", "nonesuch.yaml"),
        "command line: the ROS arguments must be well-formed, got Couldn't parse params file",
    ),
    (
        ("emulator_node.node", "-p", "gibberish"),
        "command line: the ROS arguments must be well-formed, got Couldn't parse parameter over",
    ),
]
REFUSED_COMMANDS = [
    (("up", "nonesuch"), "arm_emulator: file nonesuch must exist"),
    (("demo", "nonesuch"), "arm_emulator: file nonesuch must exist"),
    (("run", "nonesuch"), "arm_emulator: file nonesuch must exist"),
    (("run", "three_axis", "--seconds", "0"), "run: seconds must be at least the servo period"),
]


def start(*command: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", *command],
        cwd=Path(__file__).resolve().parents[1],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_heed_ctrl_c,  # noqa: PLW1509 - one system call, no lock
    )


def _heed_ctrl_c() -> None:
    """In the child: whoever runs the tests in the background of a shell ignores SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_what_is_not_taken_is_told_in_one_line_with_exit_code_2() -> None:
    assert find_config("three_axis", ".yaml", "servo").is_file()
    cases = [((module, "--ros-args", *more), words, 1) for (module, *more), words in REFUSED_NODES]
    cases += [((one, "--ros-args", *more), words, 2) for (one, *more), words in REFUSED_BY_ROS]
    cases += [(("arm_emulator", *command), words, 1) for command, words in REFUSED_COMMANDS]
    with own_domain():
        started = [(start(*command), command, words, lines) for command, words, lines in cases]
        for process, command, words, lines in started:
            said, complaint = process.communicate(timeout=PATIENCE)
            assert process.returncode == 2, (command, complaint)
            assert said == "", command
            *before, last = complaint.splitlines()
            assert last.startswith(words), complaint
            assert len(before) == lines - 1, complaint


INTERRUPTED = """
import os, signal
from rclpy.node import Node
from arm_emulator.node_shell import run_node

def ctrl_c():
    os.kill(os.getpid(), signal.SIGINT)

class Interrupted(Node):
    def __init__(self):
        super().__init__("interrupted")
        {set_up}
        self.create_timer(0.01, ctrl_c)

    def close(self):
        ctrl_c()
        print("closed")

run_node(Interrupted)
"""


@pytest.mark.parametrize(("set_up", "words"), [("ctrl_c()", ""), ("pass", "closed\n")])
def test_ctrl_c_breaks_off_the_set_up_and_never_the_ending(set_up: str, words: str) -> None:
    command = [sys.executable, "-c", INTERRUPTED.format(set_up=set_up)]
    with own_domain():
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert (done.stdout, done.stderr) == (words, "")


LOCKED_UP = """
import ctypes
from arm_emulator.end_anyway import end_anyway

print("ended, but for the middleware")
end_anyway(0.1, {code})
ctypes.PyDLL(None).sleep(600)  # with Python's lock
"""


@pytest.mark.parametrize("code", [0, 1])
def test_a_middleware_that_locks_up_does_not_keep_a_process(code: int) -> None:
    command = [sys.executable, "-c", LOCKED_UP.format(code=code)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert (done.returncode, done.stdout) == (code, "ended, but for the middleware\n")


# ---------------------------------------------------------------------------------- arm_emulator up


@contextmanager
def up(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], list[psutil.Process], User]]:
    """Start `arm_emulator up` and wait until its three nodes run the machine."""
    with own_domain() as domain:
        user = User(domain)
        launcher = start("arm_emulator", "up", "three_axis", *arguments)
        children: list[psutil.Process] = []
        try:
            user.wait("the run", lambda: user.tick >= 100)
            children = psutil.Process(launcher.pid).children(recursive=True)
            assert sorted(map(node_of, children)) == ["emulator", "motion_controller", "servo"]
            yield launcher, children, user
            for child in children:
                wait(lambda child=child: not child.is_running() or child.status() == "zombie")
        finally:
            user.close()
            launcher.kill()
            for child in children:
                if child.is_running():
                    child.kill()
            launcher.communicate()


def node_of(process: psutil.Process) -> str:
    """Return the name of the node that a process is."""
    module = next(word for word in process.cmdline() if word.endswith("_node.node"))
    return module.removesuffix("_node.node")


def wait(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_up_ends_all_on_request(stop: signal.Signals) -> None:
    with up() as (launcher, _, _):
        launcher.send_signal(stop)
        said, complaint = launcher.communicate(timeout=PATIENCE)
        assert launcher.returncode == 0
        assert said == ""
        assert "Traceback" not in complaint, complaint


@pytest.mark.parametrize("name", ["emulator", "servo", "motion_controller"])
def test_up_ends_all_when_one_ends(name: str) -> None:
    with up() as (launcher, children, _):
        next(child for child in children if node_of(child) == name).kill()
        said, complaint = launcher.communicate(timeout=PATIENCE)
        assert launcher.returncode == 128 + signal.SIGKILL
        assert f"{name} ended with exit code {-signal.SIGKILL}; ending the others" in said
        assert "Traceback" not in complaint, complaint


def test_up_that_is_killed_leaves_no_node() -> None:
    with up("--clock", "realtime", "--start", "free_run") as (launcher, _, _):
        launcher.kill()
        launcher.wait(PATIENCE)


def test_up_tells_of_a_node_that_cannot_start() -> None:
    """The port of the Rerun stream is taken: the emulator says no, and the others end."""
    with own_domain(), socket_on_a_port() as port:
        launcher = start("arm_emulator", "up", "three_axis", "--rerun-port", str(port))
        said, complaint = launcher.communicate(timeout=PATIENCE)
        assert launcher.returncode == 2
        assert "emulator ended with exit code 2; ending the others" in said
        assert f"{port}" in complaint and "Traceback" not in complaint


@contextmanager
def socket_on_a_port() -> Iterator[int]:
    """Take a TCP port."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        yield taken.getsockname()[1]
