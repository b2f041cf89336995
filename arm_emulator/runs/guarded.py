"""A user's library in a child process: however it ends, this process reports where.

The library shares its process with Python. If it exits or crashes, it ends that process with any
exit code. So the run continues in a child, and this process waits for its end.
"""

import ctypes
import mmap
import os
import pickle
import select
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import IO, NoReturn, TypeVar

from arm_emulator.base.process import request_signal_at_parent_end
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.firmware import RunningCode, make_progress
from arm_emulator.tick.c import FIRMWARE_CONTROLLER
from arm_emulator.toolchain.c_header import CData

Outcome = TypeVar("Outcome")

LOOK = 1.0  # s, after which a library that has not returned is looked at
REPORT_STALL = 5.0  # s


def run_guarded(name: str, work: Callable[[CData], Outcome]) -> Outcome:
    """Do work that calls a user's library, and return its outcome.

    Under a debugger it is done in this process, which the debugger watches.

    Args:
        name: of the library, for reports.
        work: writes where it is into the progress that it gets.

    Raises:
        Refusal: the library has ended the process, or what the work raises.
    """
    if is_debugged():
        return work(make_progress())
    progress = make_progress(mmap.mmap(-1, FIRMWARE_CONTROLLER.get_size("firmware_progress")))
    sys.stdout.flush()
    sys.stderr.flush()
    watcher = os.getpid()
    with tempfile.TemporaryFile(buffering=0) as outcome:
        child = os.fork()
        if child == 0:
            _do_work(work, progress, watcher, outcome)
        try:
            status = _wait_for_child(child, name, progress)
        except KeyboardInterrupt:
            print(f"{name}, tick {progress.controller.tick}: ended by a signal", file=sys.stderr)
            raise
        code = os.waitstatus_to_exitcode(status)
        if progress.doing == RunningCode.ENDED and code == 0:
            outcome.seek(0)
            result: Outcome | BaseException = pickle.load(outcome)
            if isinstance(result, BaseException):
                raise result
            return result
    actual = f"exit with code {code}" if code >= 0 else _name_signal(-code)
    where = (
        f"{name}, tick {progress.controller.tick}" if progress.doing == RunningCode.STEP else name
    )
    raise Refusal(where, *RunningCode(progress.doing).must, actual)


def _do_work(
    work: Callable[[CData], object], progress: CData, watcher: int, outcome: IO[bytes]
) -> NoReturn:
    request_signal_at_parent_end(signal.SIGKILL)
    result: object = SystemExit(1)
    if os.getppid() == watcher:
        try:
            result = work(progress)
        except (Refusal, KeyboardInterrupt) as error:
            result = error
        except BaseException:
            traceback.print_exc()
    outcome.write(pickle.dumps(result))
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)  # what the library has printed
    progress.doing = RunningCode.ENDED
    os._exit(0)


def _wait_for_child(child: int, name: str, progress: CData) -> int:
    """Wait for the child, and return its status; report a library that does not return."""
    looks, tick = 0, -1  # how often it was found at this tick
    with open(os.pidfd_open(child)) as end:
        try:
            while not select.select([end], [], [], LOOK)[0]:
                stands = progress.doing != RunningCode.OURS and progress.controller.tick == tick
                looks, tick = looks + 1 if stands else 0, progress.controller.tick
                if looks == round(REPORT_STALL / LOOK):
                    quantity = RunningCode(progress.doing).must[0]
                    print(
                        f"{name}, tick {tick}: {quantity} has not returned for {REPORT_STALL:g} s; "
                        "Ctrl-C ends it",
                        file=sys.stderr,
                    )
        except KeyboardInterrupt:
            os.kill(child, signal.SIGKILL)
            raise
        finally:
            status = os.waitpid(child, 0)[1]
    return status


def _name_signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def is_debugged() -> bool:
    """Whether a debugger watches this process."""
    try:
        words = Path("/proc/self/status").read_text(encoding="ascii").split()
    except OSError:
        return False
    return words[words.index("TracerPid:") + 1] != "0"
