"""Our example of launch_testing passes, where ROS's launch is installed."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("launch_testing.launch_test")
pytest.importorskip("launch_ros")
EXAMPLE = Path(__file__).resolve().parents[2] / "examples/my_launch_test.py"


def test_our_example_passes() -> None:
    words = [sys.executable, "-m", "launch_testing.launch_test", str(EXAMPLE)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr.count("\nOK\n") == 2, "while the nodes run, and after their end"
