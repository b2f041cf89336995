"""Exit codes of the launch file, where ROS's launch is installed."""

import subprocess
import sys
from pathlib import Path

import pytest

from arm_emulator.ros.process.ros_domain import own_domain

pytest.importorskip("launch")
pytest.importorskip("launch_ros")
FILE = Path(__file__).resolve().parents[2] / "launch/bringup.launch.py"
# As `ros2 launch` runs a file.
PROGRAM = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource

file, *words = sys.argv[1:]
arguments = [word.split(":=") for word in words]
service = LaunchService(argv=words)
included = IncludeLaunchDescription(AnyLaunchDescriptionSource(file), launch_arguments=arguments)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""


def launched(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", PROGRAM, str(FILE), *words]
    with own_domain():
        return subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)


@pytest.mark.parametrize(
    ("word", "refusal"),
    [
        ("scene:=nonesuch", "arm_emulator: file nonesuch must exist"),
        ("params_file:=nonesuch.yaml", "bringup: file nonesuch.yaml must exist"),
        ("pace:=-3", "bringup: pace must be max, or times real time, above 0"),
    ],
)
def test_refused_arguments_are_a_line_and_exit_code_2(word: str, refusal: str) -> None:
    done = launched(word)
    lines = [line for line in done.stderr.splitlines() if line.startswith(refusal)]
    assert (done.returncode, len(lines)) == (2, 1), done.stdout + done.stderr
    assert "Traceback" not in done.stderr


def test_a_node_that_fails_gives_the_launch_its_exit_code(tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("servo:\n  ros__parameters:\n    hold_after: -3.0\n", encoding="utf-8")
    done = launched(f"params_file:={file}")
    printed = done.stdout + done.stderr
    assert done.returncode == 2, printed
    assert "hold_after must be a number > 0 s" in printed
    assert printed.count("process started") == 3 and "Traceback" not in printed
