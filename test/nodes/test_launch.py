"""Start, refusal and end of the nodes: alone and together."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
import rclpy
from draws import some
from network import PATIENCE

from arm_emulator.base.io.config_files import find_config
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.process.end_with_parent import VARIABLE
from arm_emulator.ros.process.ros_domain import own_domain
from emulator_node.node import EmulatorNode
from motion_controller_node.node import MotionControllerNode
from servo_node.node import ServoNode

SERVO = ("servo_node.node", "--params-file", "config/servo/three_axis.yaml")
NODES = {
    "emulator_node.node": EmulatorNode,
    "servo_node.node": ServoNode,
    "motion_controller_node.node": MotionControllerNode,
}
# Module and arguments after --ros-args, and what is reported: first one of each node.
REFUSED_NODES = [
    (("emulator_node.node", "-p", "scene:=nonesuch"), "arm_emulator: file nonesuch must exist"),
    (
        ("servo_node.node",),
        "node servo: its parameters must come from a file, got no file; valid: --ros-args "
        "--params-file config/servo/three_axis.yaml",
    ),
    (
        ("motion_controller_node.node", "-p", "weight:=2.0"),
        "node motion_controller: parameter weight must be a number from 1e-06 to 1, got 2.0",
    ),
    (
        ("emulator_node.node", "-p", "clock:=sundial"),
        "node emulator: parameter clock must be known, got 'sundial'; valid: lockstep, realtime",
    ),
    (
        ("emulator_node.node", "-p", "timeout:=-1.0"),
        "node emulator: parameter timeout must be a number from 0.1 to 3600 s, got -1.0",
    ),
    (
        ("emulator_node.node", "-p", "timout:=3.0"),
        "node emulator: parameter timout must be a known one, got an unknown one, "
        "perhaps for timeout; valid: scene, ",
    ),
    ((*SERVO, "-p", "speed:=3.0"), "parameters of node servo: speed must be a known key"),
    (("emulator_node.node", "-p", "scene:=3"), "node emulator: parameter scene must be a text"),
    (("emulator_node.node", "-p", "scene:=setup.py"), "setup.py: file must be "),
    (
        (*SERVO, "-p", "hold_after:=-3.0"),
        "parameters of node servo: hold_after must be a number > 0 s, got -3.0",
    ),
    (
        (*SERVO, "-p", "joints.elbow.resistance:=none"),
        "parameters of node servo: joints.elbow.resistance must be a number >= 0 ohm, got 'none'",
    ),
    (
        (*SERVO, "-p", "joints.knee.resistance:=1.0"),
        "parameters of node servo: joints.knee must be a known key",
    ),
    (
        ("motion_controller_node.node", "-p", "weight:=half"),
        "node motion_controller: parameter weight must be a number from 1e-06 to 1, got 'half'",
    ),
]
# Arguments that ROS itself refuses, with a line of its own before ours.
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


def start(*command: str, ignores_ctrl_c: bool = False) -> subprocess.Popen[str]:
    """Start a module; ignoring Ctrl-C is what `&` in a script makes a job begin with."""
    return subprocess.Popen(
        [sys.executable, "-m", *command],
        cwd=Path(__file__).resolve().parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_ignore_ctrl_c if ignores_ctrl_c else _handle_ctrl_c,  # noqa: PLW1509
        start_new_session=True,
    )


def _ignore_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _handle_ctrl_c() -> None:
    """In the child: whoever runs the tests in the background of a shell ignores SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def wait(condition: Callable[[], bool], expectation: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, f"waited {PATIENCE:g} s for {expectation}"
        time.sleep(0.02)


def test_nodes_refuse_wrong_arguments_in_these_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).resolve().parents[2])
    with own_domain():
        for (module, *more), words in REFUSED_NODES:
            rclpy.init(args=["--ros-args", *more])
            try:
                with pytest.raises(Refusal) as refusal:
                    NODES[module]()
            finally:
                rclpy.shutdown()
            printed = str(refusal.value)
            assert printed.startswith(words) and "\n" not in printed, printed


@pytest.mark.slow
def test_wrong_arguments_are_reported_in_a_line_with_exit_code_2() -> None:
    file = find_config("three_axis", ".yaml", "servo")
    assert file.is_file(), f"{file} is what refusals name"
    nodes, ros, commands = some(REFUSED_NODES, 3), some(REFUSED_BY_ROS, 1), REFUSED_COMMANDS
    cases = [((module, "--ros-args", *more), words, 1) for (module, *more), words in nodes]
    cases += [((node, "--ros-args", *more), words, 2) for (node, *more), words in ros]
    cases += [(("arm_emulator", *command), words, 1) for command, words in commands]
    with own_domain():
        started = [(start(*command), command, words, lines) for command, words, lines in cases]
        for process, command, words, lines in started:
            printed, complaint = process.communicate(timeout=PATIENCE)
            assert process.returncode == 2, (command, complaint)
            assert printed == "", command
            *before, last = complaint.splitlines()
            assert last.startswith(words), complaint
            own = [line for line in before if not line.startswith("compiling ")]
            assert len(own) == lines - 1, complaint


# Commands, and their exit codes after signals.
BREAKS_OFF = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}
ENDS = dict.fromkeys(BREAKS_OFF, 0)
STOPPED = [
    (("arm_emulator", "up"), ENDS),
    (("arm_emulator", "record", "{folder}/bag"), ENDS),
    (("arm_emulator", "run", "--seconds", "1e5"), BREAKS_OFF),
    (("arm_emulator", "demo", "--out", "{folder}/out"), BREAKS_OFF),
    (("arm_emulator", "advise", "--error", "1e-7"), BREAKS_OFF),
    (("arm_emulator", "compile", "--into", "{folder}/lib"), BREAKS_OFF),
    (("emulator_node.node",), ENDS),
    (("servo_node.node", "--ros-args", "--params-file", "config/servo/three_axis.yaml"), ENDS),
    (("motion_controller_node.node",), ENDS),
]
MOMENTS = int(os.environ.get("MOMENTS", "1"))  # of each command


def catches(process: subprocess.Popen[str], number: int) -> bool:
    """Whether a process takes care of a signal itself; of SIGTERM Python alone never does."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = next(line.split()[1] for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught, 16) >> (number - 1) & 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(MOMENTS))
def test_every_command_and_node_ends_without_a_traceback_at_any_moment(
    tmp_path: Path, seed: int
) -> None:
    """In the first five seconds after Python has read our first line; MOMENTS=20 is the sweep."""
    rng = random.Random(f"{os.environ.get('SEED', '')}{seed}")
    with own_domain():
        for number, (command, codes) in enumerate(STOPPED):
            folder = tmp_path / f"{number}"
            folder.mkdir()
            stop = rng.choice([*codes])
            process = start(*(word.format(folder=folder) for word in command))
            try:
                ready = f"{process} to heed SIGTERM"
                wait(lambda p=process: p.poll() is not None or catches(p, signal.SIGTERM), ready)
                moment = 5.0 * rng.random() ** 3  # most of the start-up is in the first second
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(moment)
                process.send_signal(stop)
                printed, complaint = process.communicate(timeout=PATIENCE)
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            reported = (
                f"{command}, {stop.name} after {moment:.3f} s: {process.returncode} {complaint}"
            )
            # A command that ends by itself may be done.
            terminates = command[1:] and command[1] in ("demo", "advise", "compile")
            finished = terminates and process.returncode == 0
            assert process.returncode == codes[stop] or finished, reported
            for word in ("Traceback", "Exception", "Error"):
                assert word not in printed + complaint, reported
            assert_no_process_left(process.pid, reported)


def assert_no_process_left(session: int, reported: str) -> None:
    def left() -> list[int]:
        result = []
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, ProcessLookupError):
                if os.getsid(process.pid) == session and process.status() != "zombie":
                    result.append(process.pid)
        return result

    deadline = time.monotonic() + PATIENCE
    while result := left():
        assert time.monotonic() < deadline, f"{reported}; left: {result}"
        time.sleep(0.05)


LAUNCHER = """
import os, subprocess, sys, time
from arm_emulator.ros.process.end_with_parent import get_parent_environment

for node in ("emulator_node.node", "motion_controller_node.node"):
    started = subprocess.Popen(
        [sys.executable, "-m", node], env={**os.environ, **get_parent_environment()}
    )
    print(started.pid, flush=True)
time.sleep(1000)
"""


@pytest.mark.slow
@pytest.mark.parametrize("stop", some([signal.SIGKILL, signal.SIGTERM], 1))
def test_nodes_end_with_a_launcher_that_leaves_them(stop: signal.Signals) -> None:
    """As `ros2 launch` does when it is ended by SIGTERM, at any moment."""
    rng = random.Random(f"{os.environ.get('SEED', '')}{stop}")
    for _ in some(range(2), 1):
        with own_domain():
            launcher = subprocess.Popen(
                [sys.executable, "-c", LAUNCHER],
                cwd=Path(__file__).resolve().parents[2],
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
            assert launcher.stdout is not None
            nodes = [int(launcher.stdout.readline()) for _ in range(2)]
            with contextlib.suppress(subprocess.TimeoutExpired):
                launcher.wait(rng.uniform(0.0, 3.0))
            launcher.send_signal(stop)
            launcher.wait(PATIENCE)
            try:
                assert_no_process_left(launcher.pid, f"nodes {nodes} of a launcher ended by {stop}")
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(launcher.pid, signal.SIGKILL)
                launcher.stdout.close()


NODE = """
from arm_emulator.ros.process.end_with_parent import end_with_parent

end_with_parent()
print("runs")
"""


def test_a_launcher_that_has_ended_counts_as_ended_before_it_is_waited_for() -> None:
    launcher = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, launcher.pid, os.WEXITED | os.WNOWAIT)
    for number, words in ((launcher.pid, ""), (os.getpid(), "runs\n")):
        done = subprocess.run(
            [sys.executable, "-c", NODE], env={**os.environ, VARIABLE: str(number)},
            capture_output=True, text=True, check=True, timeout=PATIENCE,
        )  # fmt: skip
        assert (done.stdout, done.stderr) == (words, "")
    launcher.wait()


INTERRUPTED = """
import atexit, os, signal
from arm_emulator.ros.node import node_shell
from arm_emulator.ros.node.managed_node import ManagedNode

def ctrl_c():
    os.kill(os.getpid(), signal.{signal})

def interrupted():
    {first}

class Interrupted(ManagedNode):
    def __init__(self):
        super().__init__("interrupted")
        {set_up}
        self.create_timer(0.01, ctrl_c)

    def close(self):
        ctrl_c()
        print("closed")

node_shell.end_with_parent = interrupted
atexit.register(ctrl_c)
node_shell.run_node(Interrupted)
"""


@pytest.mark.parametrize(
    ("signal_name", "first", "set_up", "words"),
    [
        ("SIGINT", "ctrl_c()", "pass", ""),
        ("SIGHUP", "pass", "ctrl_c()", ""),
        ("SIGINT", "pass", "pass", "closed\n"),
        ("SIGHUP", "pass", "pass", "closed\n"),
    ],
)
def test_ctrl_c_breaks_off_the_set_up_and_never_the_ending(
    signal_name: str, first: str, set_up: str, words: str
) -> None:
    code = INTERRUPTED.format(signal=signal_name, first=first, set_up=set_up)
    command = [sys.executable, "-c", code]
    with own_domain():
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    assert (done.stdout, done.stderr) == (words, ""), "what it states"


INTERRUPTED_RECORD = """
import os, signal, sys
from arm_emulator.ros.recording.bag_writer import BagWriter
from emulator_node import node

def flush(bag, do=BagWriter.flush):
    do(bag)
    os.kill(os.getpid(), signal.SIGINT)

BagWriter.flush = flush
sys.argv[1:] = ["--ros-args", "-p", "record:={folder}"]
node.main()
"""


def test_ctrl_c_while_the_emulator_begins_a_record_leaves_a_complete_bag(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    with own_domain():
        command = [sys.executable, "-c", INTERRUPTED_RECORD.format(folder=folder)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True)
    errors = [line for line in done.stderr.splitlines() if not line.startswith("compiling ")]
    assert not errors and f"{folder}: 0 messages" in done.stdout
    assert sorted(file.name for file in folder.iterdir()) == ["bag_0.mcap", "metadata.yaml"]


WORKS_ON = """
import atexit, os, signal
from arm_emulator.ros.process.ctrl_c import CtrlC, end_at_once

def hang_up():
    os.kill(os.getpid(), signal.SIGHUP)

signal.signal(signal.SIGHUP, signal.{handler})
end_at_once(None)
with CtrlC(None):
    hang_up()
    print("works")
atexit.register(hang_up)
print("ends", CtrlC.signal)
"""


@pytest.mark.parametrize(
    ("handler", "words"), [("SIG_IGN", "works\nends 0\n"), ("SIG_DFL", "ends 1\n")]
)
def test_a_terminal_that_is_closed_ends_a_process_unless_nohup_began_it(
    handler: str, words: str
) -> None:
    code = WORKS_ON.format(handler=handler)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, words, "")


SPOILED_END = """
import ctypes
from arm_emulator.workarounds.exit_watchdog import start_exit_watchdog

print("ended, but for the middleware")
with start_exit_watchdog({seconds}, {code}):
    ctypes.PyDLL(None).{call}  # with Python's lock
"""


@pytest.mark.parametrize("code", [0, 1])
@pytest.mark.parametrize("call", ["sleep(600)", "memset(8, 0, 8)", "abort()"])
def test_a_middleware_that_locks_up_or_crashes_changes_no_exit_code(code: int, call: str) -> None:
    command = [sys.executable, "-c", SPOILED_END.format(seconds=0.1, code=code, call=call)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == code, done.stderr
    assert done.stdout == "ended, but for the middleware\n", "what it states"


def test_a_crash_after_the_middleware_has_ended_is_a_crash() -> None:
    crash = SPOILED_END.format(seconds=60.0, code=0, call="getpid()") + "ctypes.memset(8, 0, 8)"
    done = subprocess.run([sys.executable, "-c", crash], timeout=PATIENCE, check=False)
    assert done.returncode == -signal.SIGSEGV
