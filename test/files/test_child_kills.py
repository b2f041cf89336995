"""Processes that take rows of a run: killed, stopped, noisy, or left by a run that was killed.

`python -m bench.child_kills --count 200` is the same at full size.
"""

import os
import signal
import time
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from draws import some, with_slow

from arm_emulator import Plant, Refusal
from arm_emulator.base import packages
from arm_emulator.base.process import is_running
from arm_emulator.base.run_outputs import RunOutputs
from arm_emulator.page import page_process
from arm_emulator.runs import recorder, row_process
from arm_emulator.runs.row_process import RowProcess, dismiss_all
from bench.child_kills import HOW, KillCase

CASES = [(child, how) for how in HOW for child in ("recorder", "viewer")]
LONGEST = 5.0  # s, wall
PATIENCE = 120.0  # s, wall
MODULE = """
import os, signal, sys, time
from pathlib import Path
from arm_emulator.runs.row_end import RowEnd
end = RowEnd(niceness=0, grace=0.5)
print(200_000 * "x", flush=True)
end.send_answer("ready")
while not end.is_over(30.0):
    pass
if "meets" in end.task:  # all that are to end, before it ends
    folder, count = end.task["meets"]
    Path(folder, f"asked_{os.getpid()}").touch()
    while len(list(Path(folder).glob("asked_*"))) < count:
        time.sleep(0.01)
    Path(folder, f"met_{os.getpid()}").touch()
if end.task["hangs"]:
    while True:
        time.sleep(60.0)
end.send_answer("over")
if end.task.get("stays"):
    time.sleep(60.0)
end.send_last_answer("never read")
"""


@pytest.mark.slow
@pytest.mark.parametrize(("child", "how"), with_slow(some(CASES[::-1], 3), 1))
def test_a_run_goes_on_and_nothing_stays(child: str, how: str, tmp_path: Path) -> None:
    case = KillCase(child, HOW[how], 0.2, tmp_path)
    assert case.wait < LONGEST and case.end < LONGEST and not case.left


@pytest.fixture
def noisy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module that prints more than a pipe holds before it answers."""
    (tmp_path / "noisy_rows.py").write_text(MODULE)
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", path)
    return "noisy_rows"


def test_a_process_that_has_answered_is_not_waited_for(noisy: str) -> None:
    task = {"hangs": False, "stays": True}
    process = RowProcess(Plant("three_axis"), noisy, task, "test", waits=False, patience=30.0)
    begun = time.monotonic()
    assert process.close() == "over"
    assert time.monotonic() - begun < 0.5 * LONGEST and not is_running(process.process_id)


def test_processes_of_a_run_end_together(noisy: str, tmp_path: Path) -> None:
    """Each ends when all three are asked to: one after another they would be killed.

    They answer although they print more than a pipe holds.
    """
    plant, meets = Plant("three_axis"), {"hangs": False, "meets": (str(tmp_path), 3)}
    every = [
        RowProcess(plant, noisy, meets, "test", waits=False, patience=PATIENCE) for _ in range(3)
    ]
    task = {"hangs": False}
    second = RowProcess(Plant("three_axis"), noisy, task, "test", waits=False, patience=PATIENCE)
    dismiss_all(plant)
    assert [process.close() for process in every] == 3 * ["over"]
    assert second.ready == "ready" and not second.trouble
    assert second.close() == "over"


@pytest.mark.slow
def test_processes_that_hang_are_killed_at_a_common_deadline(noisy: str) -> None:
    plant, task, patience = Plant("three_axis"), {"hangs": True}, 4.0
    every = [
        RowProcess(plant, noisy, task, "test", waits=False, patience=patience) for _ in range(3)
    ]
    begun = time.monotonic()
    dismiss_all(plant)
    responses = [process.close() for process in every]
    assert all("killed by SIGKILL" in str(answer) for answer in responses)
    assert time.monotonic() - begun < 2.8 * patience


def test_further_signals_give_no_further_time(noisy: str) -> None:
    """The first SIGTERM gives it 0.5 s, whatever its code does."""
    process = RowProcess(
        Plant("three_axis"), noisy, {"hangs": True}, "test", waits=False, patience=30.0
    )
    begun = time.monotonic()
    while is_running(process.process_id):
        os.kill(process.process_id, signal.SIGTERM)
        assert time.monotonic() - begun < LONGEST, "each signal gives it time"
        time.sleep(0.1)
    assert "killed by SIGALRM" in process.trouble
    assert isinstance(process.close(), Refusal)


def test_ctrl_c_tells_the_recorder_before_the_page_has_ended(
    noisy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each ends when both are asked to: one after the other, the first would be killed."""
    page = EntryPoint("live", noisy, packages.PAGE)
    monkeypatch.setattr(page_process, "find_page_entry", lambda _: page)
    monkeypatch.setattr(recorder, "PROCESS", noisy)
    for module in (page_process, recorder):
        monkeypatch.setattr(module, "PATIENCE", 60.0)
    began = row_process._start_process

    def begin(module: str, task: dict[str, Any], files: tuple[int, ...]) -> Any:
        return began(module, task | {"hangs": False, "meets": (str(tmp_path), 2)}, files)

    monkeypatch.setattr(row_process, "_start_process", begin)
    plant = Plant("three_axis")
    with (
        pytest.raises(Refusal, match="over"),  # what this recorder calls its trouble
        recorder.Recorder(plant, RunOutputs(record=Path("never.csv")), waits=False),
        page_process.PageProcess(plant, 0),
    ):
        raise KeyboardInterrupt
    assert len(list(tmp_path.glob("met_*"))) == 2
