"""Nothing of the user's folder is imported, whatever the files in it are called."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from draws import with_slow
from network import network

from arm_emulator.base.io.config_files import find_config_folder

OURS = ("arm_emulator_msgs bench emulator_node motion_controller_node oracles servo_node").split()
OTHERS = (
    "ament_index_python can canopen elftools geometry_msgs lz4 matplotlib mcap numpy pinocchio "
    "rclpy rerun rich rpyutils scipy sensor_msgs std_msgs unicorn xacro yaml zstandard"
).split()
# Modules that Python itself has loaded when it looks for the argument of `-m`.
EARLY = subprocess.run(
    [sys.executable, "-c", "import runpy, sys; print(*sys.modules)"],
    capture_output=True, text=True, check=True,
).stdout.split()  # fmt: skip
STANDARD = {name for name in sys.stdlib_module_names if not name.startswith("_")} - set(EARLY)
IMPORTED = "imported from the working folder"
ROBOT = "spoiled.urdf"  # whose machine `test_spoiled_files` has, too


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of a user with files of every name that somebody imports."""
    for name in (*OURS, *OTHERS, *STANDARD):
        (tmp_path / f"{name}.py").write_text(f"raise SystemExit('{name} {IMPORTED}')\n")
    return tmp_path


COMMANDS = (
    ("check-scene", "three_axis"),
    ("run", "three_axis", "--seconds", "0.05"),
    ("canopen", "three_axis", "--eds", "eds"),
    ("new", ROBOT, "--out", "made"),
    ("replay", "nothing"),
)


def command(folder: Path, *words: str, path: str = "") -> None:
    """Run a command in a folder, which it must not look into for modules."""
    done = subprocess.run(
        [sys.executable, "-m", "arm_emulator", *words],
        cwd=folder, capture_output=True, text=True, timeout=120.0, check=False,
        env={**os.environ, "PYTHONPATH": f"{os.environ['PYTHONPATH']}{path}"},
    )  # fmt: skip
    assert IMPORTED not in done.stdout + done.stderr, done.stderr
    assert done.returncode == (2 if words[1] == "nothing" else 0), done.stderr


@pytest.mark.parametrize(
    "words", with_slow(((words,) for words in COMMANDS), 1), ids=lambda words: words[0]
)
def test_a_command_imports_nothing_of_the_working_folder(
    words: tuple[str, ...], folder: Path
) -> None:
    urdf = (find_config_folder() / "urdf" / "three_axis.urdf").read_text()
    (folder / ROBOT).write_text(urdf)
    command(folder, *words)


@pytest.mark.slow
def test_an_empty_entry_in_pythonpath_is_not_followed(folder: Path) -> None:
    """As `PYTHONPATH=$PYTHONPATH:` has, which Python takes for the working folder."""
    for name in STANDARD:  # Python itself imports some at its start
        (folder / f"{name}.py").unlink()
    command(folder, "run", "three_axis", "--seconds", "0.05", path=":")


@pytest.mark.slow
@pytest.mark.parametrize(
    "node", with_slow(["emulator_node", "servo_node", "motion_controller_node"], 1)
)
def test_a_node_imports_nothing_of_the_working_folder(node: str, folder: Path) -> None:
    (folder / f"{node}.py").unlink()  # which Python itself takes for the one to start
    done = subprocess.run(
        [sys.executable, "-m", f"{node}.node", "--ros-args", "-p", "clock:=no_clock"],
        cwd=folder, capture_output=True, text=True, timeout=120.0, check=False,
    )  # fmt: skip
    assert IMPORTED not in done.stdout + done.stderr, done.stderr
    assert done.returncode == 2 or "Refusal" not in done.stderr, done.stderr


@pytest.mark.slow
def test_a_network_imports_nothing_of_the_working_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    with network(folder / "log", start="first_answer") as (user, _):
        user.wait("the run", lambda: user.tick > 20)
