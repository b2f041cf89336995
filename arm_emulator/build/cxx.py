"""Runs of a compiler, with bounds on time and output."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from arm_emulator.base.refusal import Refusal

LONGEST_RUN = 900.0  # s; the largest scenes take a minute, more on a busy machine
MOST_WORDS = 65536  # bytes of a compiler's output that are kept


def run_compiler(command: list[str], folder: Path, where: str, part: str) -> None:
    """Run a compiler to its end.

    Args:
        command: its words.
        folder: folder of its files; removed from its messages.
        where: name in refusals.
        part: name of the unit.

    Raises:
        Refusal: it cannot be run, fails, is killed, or does not end.
    """
    process: subprocess.Popen[bytes] | None = None
    try:
        with _signals_held_back():  # a signal at this point would orphan it
            # In a session of its own, so that it can be ended with all its children.
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        words = _listen(process)
    except TimeoutError:
        raise _failure(where, part, command, f"no end within {LONGEST_RUN:g} s") from None
    except OSError as error:
        raise _failure(where, part, command, error.strerror or str(error)) from None
    finally:
        if process is not None:
            if process.returncode is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            assert process.stdout is not None
            process.stdout.close()
    if process.returncode == 0:
        return
    if process.returncode < 0:
        end = f"ended by signal {-process.returncode}"
        with contextlib.suppress(ValueError):
            end = f"ended by {signal.Signals(-process.returncode).name}"
    else:
        end = f"exit code {process.returncode}"
    text = words.decode(errors="replace").replace(f"{folder}/", "")
    lines = [line for line in text.splitlines() if line.strip()]
    reasons = [line for line in lines if "error" in line.lower()] or lines
    raise _failure(where, part, command, ": ".join([end, *reasons[:1]]))


@contextlib.contextmanager
def _signals_held_back() -> Iterator[None]:
    """Deliver Ctrl-C and SIGTERM at the end of this block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _listen(process: subprocess.Popen[bytes]) -> bytes:
    """Return the beginning of a process's output until it ends, even if others hold its pipe."""
    assert process.stdout is not None
    pipe = process.stdout.fileno()
    deadline = time.monotonic() + LONGEST_RUN
    words = b""
    while process.poll() is None:
        left = deadline - time.monotonic()
        if left <= 0.0:
            raise TimeoutError
        if not select.select([pipe], [], [], min(left, 0.1))[0]:
            continue
        heard = os.read(pipe, MOST_WORDS)
        if not heard:  # it has closed its output; the end is near
            try:
                process.wait(left)
            except subprocess.TimeoutExpired:
                raise TimeoutError from None
        words += heard[: MOST_WORDS - len(words)]
    while select.select([pipe], [], [], 0.0)[0] and len(words) < MOST_WORDS:
        heard = os.read(pipe, MOST_WORDS)
        if not heard:
            break
        words += heard
    return words


def _failure(where: str, part: str, command: list[str], got: str) -> Refusal:
    return Refusal(where, f"compiler {command[0]}", f"compile {part}", got)
