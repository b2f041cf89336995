"""Processes that take rows of a run: killed, stopped, noisy, or left by a run that was killed.

`python -m bench.child_kills --count 200` is the same at full size.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from draws import some

from arm_emulator import Plant, Refusal
from arm_emulator.base.process import runs
from arm_emulator.runs.row_process import RowProcess
from bench.child_kills import HOW, Case

CASES = [(child, how) for how in HOW for child in ("recorder", "viewer")]
LONGEST = 5.0  # s, wall
MODULE = """
import signal, sys, time
from arm_emulator.runs.row_end import RowEnd
end = RowEnd(niceness=0, grace=0.5)
print(200_000 * "x", flush=True)
end.answer("ready")
while not end.is_over(30.0):
    pass
if end.task["hangs"]:
    time.sleep(60.0)
end.answer("over")
"""


@pytest.mark.parametrize(("child", "how"), some(CASES[::-1], 3))
def test_a_run_goes_on_and_nothing_stays(child: str, how: str, tmp_path: Path) -> None:
    case = Case(child, HOW[how], 0.2, tmp_path)
    assert case.wait < LONGEST and case.end < LONGEST and not case.left


@pytest.fixture
def noisy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module that prints more than a pipe holds before it answers."""
    (tmp_path / "noisy_rows.py").write_text(MODULE)
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", path)
    return "noisy_rows"


def test_a_process_that_prints_much_still_answers(noisy: str) -> None:
    one = RowProcess(
        Plant("three_axis"), noisy, {"hangs": False}, "test", waits=False, patience=30.0
    )
    assert one.ready == "ready" and one.trouble == ""
    assert one.close() == "over"


def test_a_process_that_does_not_end_is_killed(noisy: str) -> None:
    one = RowProcess(Plant("three_axis"), noisy, {"hangs": True}, "test", waits=False, patience=0.5)
    begun = time.monotonic()
    answer = one.close()
    assert time.monotonic() - begun < LONGEST
    assert isinstance(answer, Refusal) and "killed by SIGKILL" in str(answer)


def test_sigterm_ends_a_process_that_hangs(noisy: str) -> None:
    """The system kills it after its grace, whatever its code does."""
    one = RowProcess(
        Plant("three_axis"), noisy, {"hangs": True}, "test", waits=False, patience=30.0
    )
    os.kill(one.process_id, signal.SIGTERM)
    deadline = time.monotonic() + LONGEST
    while runs(one.process_id):
        assert time.monotonic() < deadline, "it ignores SIGTERM"
        time.sleep(0.01)
    assert "killed by SIGALRM" in one.trouble
    assert isinstance(one.close(), Refusal)
