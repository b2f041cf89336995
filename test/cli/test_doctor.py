"""Findings of `doctor`: missing requirements, and remains of earlier runs."""

import fcntl
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from draws import with_slow
from test_dependencies import OF_ROS, imported

from arm_emulator.cli.commands import doctor
from arm_emulator.cli.commands.doctor import SystemFinding, run_checks
from arm_emulator.cli.output import output
from arm_emulator.ros.process.ros_domain import own_domain


def finding_of(name: str) -> SystemFinding:
    return next(finding for finding in run_checks() if finding.name == name)


@pytest.fixture
def few_imports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trying all of them takes 4 s of processor time; test_json.py runs the whole command."""
    monkeypatch.setattr(doctor, "NEEDED", ("numpy", "yaml"))
    monkeypatch.setattr(doctor, "EXTRAS", {})


def test_each_finding_is_a_line_and_a_row_of_json(
    few_imports: None, capsys: pytest.CaptureFixture[str]
) -> None:
    code = doctor.check_machine()
    lines = capsys.readouterr().out.splitlines()
    with output.print_at_end(as_json=True):
        assert doctor.check_machine() == code
    rows = json.loads(capsys.readouterr().out)["findings"]
    assert len(lines) == len(rows) >= 10
    for line, row in zip(lines, rows, strict=True):
        # The lateness of wake-ups is measured twice, and may be a note once.
        assert row["name"] in line and (line.startswith(row["level"]) or row["name"] == "priority")
        assert row["level"] in ("ok", "note", "problem")
        assert row["level"] == "ok" or row["remedy"] or " must " in row["text"], row
    assert code == any(row["level"] == "problem" for row in rows)


def test_a_missing_tool_is_a_problem_with_a_remedy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert finding_of("compiler").level == "ok"
    old = tmp_path / "old_compiler"
    old.write_text("#!/bin/sh\necho 'error: unknown standard c++20' >&2\nexit 1\n")
    old.chmod(0o755)
    monkeypatch.setenv("CXX", str(old))
    finding = finding_of("compiler")
    assert (
        finding.level == "problem"
        and "unknown standard" in finding.text
        and "g++ from 11" in finding.text
    )
    monkeypatch.setenv("CXX", "no_such_compiler")
    assert finding_of("compiler").level == "problem"
    monkeypatch.setattr(doctor, "MIN_DISK", 1e9)
    assert finding_of("disk").level == "problem" and "make room" in finding_of("disk").remedy


def test_every_import_is_tried(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Modules that are missing, and those that cannot be imported, are named with their package."""
    checked = {*doctor.NEEDED, *doctor.EXTRAS}
    ours = {entry for entry in imported("arm_emulator") if not OF_ROS.fullmatch(entry)}
    checked.add("_cffi_backend")  # which `cffi` imports itself
    assert ours <= checked, "each is needed by all, or by the commands that are named"
    (tmp_path / "coal.py").write_text("raise ImportError('libcoal.so: no such file')")
    (tmp_path / "broken_module.py").write_text("print('noise')\nraise SystemExit(0)")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(doctor, "NEEDED", ("coal", "no_such_module", "numpy"))
    monkeypatch.setattr(doctor, "EXTRAS", {"broken_module": "`this`", "no_such_extra": "`that`"})
    result = {entry.name: entry for entry in doctor.check_imports()}
    assert result["numpy"].level == "ok"
    assert result["coal"].level == "problem" and "libcoal.so" in result["coal"].text
    assert result["coal"].remedy == "pip install pin"
    assert result["no_such_module"].level == "problem"
    assert result["broken_module"].level == "note" and "`this`" in result["broken_module"].text
    assert result["no_such_extra"] == SystemFinding(
        "no_such_extra", "note", "module no_such_extra is not installed, needed by `that`",
        "pip install no_such_extra",
    )  # fmt: skip


@pytest.mark.parametrize("words", [
    ["-m", "motion_controller_node.node"], ["-m", "arm_emulator", "run", "three_axis"],
])  # fmt: skip
def test_a_program_without_a_package_ends_with_a_line(words: list[str], tmp_path: Path) -> None:
    """A node that imports at its top does so, too: `up` prints its line and ends with its code."""
    (tmp_path / "coal.py").write_text("raise ModuleNotFoundError('none', name='coal')")
    path = os.pathsep.join([str(tmp_path), os.environ["PYTHONPATH"]])
    done = subprocess.run(
        [sys.executable, *words], env=os.environ | {"PYTHONPATH": path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "Python module coal must be installed" in line and "pip install pin" in line


@pytest.mark.parametrize(
    ("domain", "reach", "level"),
    [
        ("77", "LOCALHOST", "ok"),
        ("77", "SUBNET", "note"),
        ("233", "LOCALHOST", "problem"),
        ("x", "OFF", "problem"),
        ("-1", "LOCALHOST", "problem"),
    ],
)
def test_the_domain_is_valid_and_local(
    domain: str, reach: str, level: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", reach)
    assert finding_of("ROS domain").level == level


def test_nodes_without_a_launcher_are_reported_alone() -> None:
    def numbers() -> list[str]:
        finding = finding_of("processes")
        return finding.remedy.split()[1:] if finding.level == "problem" else []

    asleep = "import time; time.sleep(600)"
    saved = subprocess.Popen([sys.executable, "-c", asleep, "servo_node.node"])
    line = f'"{sys.executable}" -c "{asleep}" servo_node.node >/dev/null 2>&1 & echo $!'
    left = int(subprocess.check_output(["sh", "-c", line]))
    try:
        deadline = time.monotonic() + 120.0
        while str(left) not in numbers() and time.monotonic() < deadline:
            status = Path(f"/proc/{left}/status").read_text()
            adopted_by = int(status.split("PPid:")[1].split()[0])
            if adopted_by not in (1, os.getpid()) and "sh\n" not in status:
                pytest.skip("another process than init adopts orphans here")
            time.sleep(0.05)
        assert str(left) in numbers() and str(saved.pid) not in numbers()
    finally:
        os.kill(left, 9)
        saved.kill()
        saved.wait()
    assert str(left) not in numbers()


def test_shared_memory_of_the_dead_is_counted_and_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from arm_emulator.workarounds import fastdds_shared_memory

    for number in range(3):
        lock = tmp_path / f"fastrtps_{number:016x}_el"
        lock.write_text("")
        os.utime(lock, (1.0, 1.0))
        (tmp_path / f"fastrtps_{number:016x}").write_text("segment")
    with open(tmp_path / f"fastrtps_{0:016x}_el") as alive:
        fcntl.flock(alive, fcntl.LOCK_EX)  # as its owner does
        monkeypatch.setattr(
            doctor, "find_left_over", lambda: fastdds_shared_memory.find_left_over(tmp_path)
        )
        finding = finding_of("shared memory")
        assert finding.level == "note" and finding.text.startswith("2 remains")
        assert len(list(tmp_path.iterdir())) == 6, "doctor removes nothing"


NETWORK = """
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int64
rclpy.init()
nodes = [rclpy.create_node(name, namespace="/cell") for name in ("one", "two")]
best = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
nodes[0].create_publisher(Clock, "clock", 1)
nodes[0].create_publisher(Int64, "number", best)
{more}
print(flush=True)
rclpy.spin(nodes[0])
"""
TWO_CLOCKS = 'nodes[1].create_publisher(Clock, "clock", 1)'
DEAF = 'nodes[1].create_subscription(Int64, "number", print, 1)'
HEARS = 'nodes[1].create_subscription(Int64, "number", print, best)'


@pytest.mark.parametrize(
    ("more", "level", "words"),
    with_slow(
        [
            (HEARS, "ok", "2 other nodes in the domain"),
            (
                DEAF,
                "note",
                "/cell/number: /cell/two hears nothing of /cell/one: Best effort publisher",
            ),
            (TWO_CLOCKS, "problem", "/cell/clock has 2 publishers: /cell/one, /cell/two"),
            (f"{DEAF}; {TWO_CLOCKS}", "problem", "/cell/two hears nothing of /cell/one"),
        ],
        1,
    ),
)
def test_clocks_and_qos_of_a_running_network(
    more: str, level: str, words: str, few_imports: None
) -> None:
    with own_domain():
        command = [sys.executable, "-c", NETWORK.format(more=more)]
        network = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert network.stdout is not None
        try:
            network.stdout.readline()
            deadline = time.monotonic() + 120.0  # a busy machine discovers later
            while words not in (finding := finding_of("network")).text or finding.level != level:
                assert time.monotonic() < deadline, finding
        finally:
            network.kill()
            network.wait()
            network.stdout.close()


def test_a_middleware_that_was_not_tried_is_a_note(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
    assert finding_of("ROS 2").level == "note"
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    assert finding_of("ROS 2").level == "ok"
