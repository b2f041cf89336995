"""The standard files of a command: none of their numbers is free for a file of another use."""

import contextlib
import os
import sys
from typing import Any

from arm_emulator.base.refusal import Refusal

_closed: list[int] = []  # of the descriptors 0 to 2, as this process began


def open_standard_files() -> None:
    """Open what is closed of stdin, stdout and stderr as an empty file; print what any text has.

    Otherwise the next file that is opened takes the number 1, and gets all that libraries print.
    Characters that the encoding of stdout lacks are printed as escapes of Python.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            _closed.append(number)
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False)
    streams: tuple[Any, ...] = (sys.stdout, sys.stderr)
    for stream in streams:
        # A stream whose descriptor was exchanged for a pipe since it was opened cannot seek.
        with contextlib.suppress(AttributeError, OSError):
            stream.reconfigure(errors="backslashreplace")


def check_stdout() -> None:
    """Refuse a stdout that was closed as this process began: its output would be lost."""
    if 1 in _closed:
        rule = "be open: a terminal, a file, or /dev/null"
        raise Refusal("arm_emulator", "stdout", rule, "one that is closed")


def drop_descriptor(number: int) -> None:
    """Let a descriptor lead nowhere: what its stream still holds can be written at the end."""
    with contextlib.suppress(OSError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, number)
        os.close(nowhere)


def find_stdout_error() -> OSError | None:
    """Return the error of stdout when it takes no more; what its stream holds is lost then.

    A stream forgets what it could not write, so that another line shows whether it can.
    """
    try:
        os.write(1, b"\n")
    except OSError as error:
        drop_descriptor(1)
        return error
    return None
