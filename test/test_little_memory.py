"""Little memory ends a command with one line."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest
from draws import some

SIZES = (400, 80, 60, 100, 160, 200, 240, 280, 320, 360, 450, 500)  # MB


@pytest.mark.parametrize("size", some(SIZES, 3))
def test_little_memory_is_a_line(size: int) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (size * 10**6,) * 2)

    done = subprocess.run(
        [sys.executable, "-m", "arm_emulator", "check-scene", "three_axis"],
        preexec_fn=limit, capture_output=True, text=True, timeout=120.0, check=False,
    )  # fmt: skip
    printed = done.stderr.splitlines()
    assert done.returncode in (0, 1, 2) and len(printed) == bool(done.returncode), done.stderr
    if done.returncode == 2:
        assert printed[0].startswith("arm_emulator: memory must suffice, got "), printed
