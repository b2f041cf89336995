"""`arm_emulator up`: its options, and how its nodes end together."""

import re
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest
from draws import some
from network import PATIENCE, User
from node_parameters import Parameters
from test_launch import start, wait

from arm_emulator.ros.process.ros_domain import own_domain


@contextmanager
def up(
    *arguments: str, ignores_ctrl_c: bool = False
) -> Iterator[tuple[subprocess.Popen[str], list[psutil.Process]]]:
    """Start `arm_emulator up` and wait until its three nodes run the machine.

    No reader is left when they end: Fast DDS may fail in a process that removes its
    participant just as others leave, and that process would be this one.
    """
    with own_domain() as domain:
        user = User(domain)
        launcher = start(
            "arm_emulator", "up", "three_axis", *arguments, ignores_ctrl_c=ignores_ctrl_c
        )
        children: list[psutil.Process] = []
        try:
            try:
                user.wait("the run", lambda: user.tick >= 100)
            finally:
                user.close()
            children = psutil.Process(launcher.pid).children(recursive=True)
            names = sorted(map(node_of, children))
            assert names == ["emulator", "motion_controller", "servo"], "nodes of `up`"
            yield launcher, children
            for child in children:
                purpose = f"{child} to end"
                wait(
                    lambda child=child: not child.is_running() or child.status() == "zombie",
                    purpose,
                )
        finally:
            end(launcher, children)


def end(launcher: subprocess.Popen[str], children: list[psutil.Process]) -> None:
    """Kill what a test has left of a network: the launcher, and all that it has started."""
    started = list(children)
    if launcher.poll() is None:
        started += psutil.Process(launcher.pid).children(recursive=True)
    for process in started:
        with suppress(psutil.NoSuchProcess):
            process.kill()
    launcher.kill()
    launcher.communicate()


@contextmanager
def started(*command: str) -> Iterator[subprocess.Popen[str]]:
    """Start a module, which ends with the block at the latest."""
    process = start(*command)
    try:
        yield process
    finally:
        end(process, [])


def node_of(process: psutil.Process) -> str:
    """Return the name of the node that a process is."""
    module = next(word for word in process.cmdline() if word.endswith("_node.node"))
    return module.removesuffix("_node.node")


@pytest.mark.slow
@pytest.mark.parametrize("name", some(["servo", "emulator", "motion_controller"], 1))
def test_up_ends_all_processes_when_a_process_ends(name: str) -> None:
    with up() as (launcher, children):
        next(child for child in children if node_of(child) == name).kill()
        printed, complaint = launcher.communicate(timeout=PATIENCE)
        assert launcher.returncode == 128 + signal.SIGKILL, complaint
        assert f"{name} ended with exit code {-signal.SIGKILL}; ending the others" in printed, (
            printed
        )
        assert "Traceback" not in complaint, complaint


@pytest.mark.slow
def test_up_that_is_killed_leaves_no_node() -> None:
    with up("--clock", "realtime", "--start", "free_run") as (launcher, _):
        launcher.kill()
        launcher.wait(PATIENCE)


@pytest.mark.slow
@pytest.mark.parametrize("stop", some([signal.SIGINT, signal.SIGTERM], 1))
def test_a_second_network_is_refused_and_the_first_goes_on_until_its_end_is_requested(
    stop: signal.Signals,
) -> None:
    """It is named, whether the second finds it before its nodes start or its emulator does.

    The first ends on request as a job of a script, too.
    """
    with up(ignores_ctrl_c=True) as (launcher, children):
        emulator = next(child for child in children if node_of(child) == "emulator")
        assert "real_time_factor:=1.0" in emulator.cmdline(), "real pace, unless another is given"
        alone = ("--ros-args", "-p", "alone:=true", "-r", "__node:=emulator_2")
        with started("emulator_node.node", *alone) as late:
            _, complaint = late.communicate(timeout=PATIENCE)
            assert late.returncode == 2, complaint
            assert f"process {emulator.pid}" in complaint, complaint
        network = ("arm_emulator", "up", "three_axis")
        with started(*network, "--namespace", "cell2") as elsewhere, started(*network) as second:
            printed, complaint = second.communicate(timeout=PATIENCE)
            assert second.returncode == 2, complaint
            # Fast DDS prints where another process takes a port of shared memory at the same time.
            ours = [line for line in printed.splitlines() if "RTPS_TRANSPORT_SHM" not in line]
            assert ours in ([], ["emulator ended with exit code 2; ending the others"]), printed
            pids = "|".join(str(child.pid) for child in children)
            rule = rf"^.*(network|emulator) must be the only one .*process ({pids})\b"
            assert re.search(rule, complaint, re.MULTILINE), complaint
            assert launcher.poll() is None and elsewhere.poll() is None
            elsewhere.send_signal(signal.SIGINT)
            _, complaint = elsewhere.communicate(timeout=PATIENCE)
            assert elsewhere.returncode == 0, complaint
        launcher.send_signal(stop)
        printed, complaint = launcher.communicate(timeout=PATIENCE)
        assert launcher.returncode == 0, complaint
        assert printed == "", "what it states"
        assert "Traceback" not in complaint, complaint


@pytest.mark.slow
def test_up_reports_of_a_node_that_cannot_start() -> None:
    """The port of the Rerun stream is taken: the emulator states no, and the others end."""
    with (
        own_domain(),
        socket_on_a_port() as port,
        started("arm_emulator", "up", "three_axis", "--rerun-port", str(port)) as launcher,
    ):
        printed, complaint = launcher.communicate(timeout=PATIENCE)
        assert launcher.returncode == 2, complaint
        assert "emulator ended with exit code 2; ending the others" in printed, printed
        assert f"{port}" in complaint and "Traceback" not in complaint, complaint


@contextmanager
def socket_on_a_port() -> Iterator[int]:
    """Take a TCP port."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        yield taken.getsockname()[1]


def test_up_takes_a_namespace_simulated_time_and_a_parameter_file(tmp_path: Path) -> None:
    """It ends when one of its processes does."""
    file = tmp_path / "mine.yaml"
    file.write_text(
        "/**/motion_controller:\n  ros__parameters: {weight: 0.125}\n"
        "/**/emulator:\n  ros__parameters: {real_time_factor: 0.5}\n"
    )
    words = ("--namespace", "cell1", "--use-sim-time", "--params-file", str(file))
    with own_domain() as domain, started("arm_emulator", "up", *words) as launcher:
        user = User(domain, "/cell1")
        try:
            names = {f"cell1/{name}" for name in ("emulator", "servo", "motion_controller")}
            user.wait("their health", lambda: names <= set(user.diagnostics))
            for name in names:
                assert user.diagnostics[name].hardware_id.startswith("cell1/"), name
                # Of logical time, which is seconds since 0, not since 1970.
                user.wait(f"time of {name}", lambda n=name: 0 < user.stamps[n] < 10**6 * 10**9)
            weight = Parameters(user).get("motion_controller", "weight")
            assert weight == 0.125, "the weight of the file"
            user.wait("the run", lambda: user.tick >= 120)
            children = psutil.Process(launcher.pid).children(recursive=True)
            next(child for child in children if node_of(child) == "servo").kill()
            printed, complaint = launcher.communicate(timeout=PATIENCE)
            assert launcher.returncode == 128 + signal.SIGKILL, complaint
            assert "ending the others" in printed, printed
        finally:
            user.close()
