"""Runs of a compiler, with bounds on time and output."""

import contextlib
import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from arm_emulator.base.process import list_end_signals
from arm_emulator.base.refusal import Refusal

LONGEST_RUN = 900.0  # s; the largest scenes take a minute, more on a busy machine
MAX_OUTPUT = 65536  # bytes of a compiler's output that are read


def run_compiler(command: list[str], folder: Path, where: str, part: str) -> str:
    """Run a compiler to its end, and return the first part of what it prints.

    Args:
        command: its words.
        folder: folder of its files, passing ones, too; removed from its messages.
        where: name in refusals.
        part: name of the unit.

    Raises:
        Refusal: it cannot be run, fails, is killed, or does not end.
    """
    process: subprocess.Popen[bytes] | None = None
    # A file, since processes that the compiler leaves behind may hold a pipe open.
    with tempfile.TemporaryFile() as words:
        try:
            with _hold_signals():  # a signal at this point would orphan it
                # In a session of its own, so that it can be ended with all its children.
                process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=words,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                    env={**os.environ, "TMPDIR": str(folder)},  # a killed one leaves its files
                )
            process.wait(LONGEST_RUN)
        except subprocess.TimeoutExpired:
            raise _refuse_run(where, part, command, f"no end within {LONGEST_RUN:g} s") from None
        except OSError as error:
            raise _refuse_run(where, part, command, error.strerror or str(error)) from None
        finally:
            if process is not None and process.returncode is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        words.seek(0)
        text = words.read(MAX_OUTPUT).decode(errors="replace")
    if process.returncode == 0:
        return text
    if process.returncode < 0:
        end = f"ended by signal {-process.returncode}"
        with contextlib.suppress(ValueError):
            end = f"ended by {signal.Signals(-process.returncode).name}"
    else:
        end = f"exit code {process.returncode}"
    lines = [line for line in text.replace(f"{folder}/", "").splitlines() if line.strip()]
    reasons = [line for line in lines if "error" in line.lower()] or lines
    raise _refuse_run(where, part, command, ": ".join([end, *reasons[:1]]))


@contextlib.contextmanager
def _hold_signals() -> Iterator[None]:
    """Deliver signals that end this process at the end of this block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, list_end_signals())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _refuse_run(where: str, part: str, command: list[str], actual: str) -> Refusal:
    return Refusal(where, f"compiler {command[0]}", f"compile {part}", actual)
