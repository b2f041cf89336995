"""The command line: choice of the command, its end, messages if it cannot run."""

import difflib
import errno
import select
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial

from arm_emulator.base.memory import is_out_of_memory
from arm_emulator.base.packages import find_package_of_command, refuse_missing_package
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.required_package import refuse_missing_module
from arm_emulator.base.standard_files import check_stdout, drop_descriptor, find_stdout_error
from arm_emulator.cli.command import (
    Command,
    command_groups,
    command_names,
    load_command,
    read_summary,
)
from arm_emulator.cli.output import output
from arm_emulator.ros.process.ctrl_c import CtrlC, end_at_once, get_exit_code

HELP = ("-h", "--help")
JSON = "--json"
# Errors of disks, not of programs.
DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
ROS_MODULES = ("rclpy", "ament_index_python", "rosidl_runtime_py")
ROS_REMEDY = (
    "commands without a network (`run`, `tune`, field buses) do without it; for this one use a "
    "checkout after `make setup`, or source a workspace with arm_emulator"
)


def main() -> None:
    """Run one command; exit code 2 and one line for refused input."""
    words = [word for word in sys.argv[1:] if word != JSON]
    as_json = len(words) < len(sys.argv) - 1
    name = words[0] if words else ""
    try:
        command = load_command(name)
    except Exception as error:
        end_at_once(None)
        sys.exit(_run_printed(partial(_print_refusal, _translate_error(name, error)), as_json))
    code = 0 if command is not None and command.until_stopped else None
    end_at_once(code)
    if command is None:
        sys.exit(_run_printed(partial(_answer_without_command, words), as_json))
    with CtrlC(code):
        sys.exit(_run_printed(partial(_run_command, command, words[1:]), as_json))
    sys.exit(get_exit_code(CtrlC.signal, code))


def _run_printed(work: Callable[[], int], as_json: bool) -> int:
    """Do work and return its exit code; end as by SIGPIPE if the reader of our output has."""
    try:
        check_stdout()
        with output.print_at_end(as_json=as_json):
            code = work()
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        if not _is_pipe_closed():
            raise
        drop_descriptor(1)  # for output not flushed yet
        return get_exit_code(signal.SIGPIPE, None)
    except Refusal as closed:
        return _print_refusal(closed)
    except OSError as error:
        of_stdout = find_stdout_error()
        if of_stdout is None and error.errno not in DISK_ERRORS:
            raise
        target = "stdout" if of_stdout else f"file {error.filename}" if error.filename else "disk"
        actual = error.strerror or error
        return _print_refusal(Refusal("arm_emulator", target, "accept all that is written", actual))


def _run_command(command: Command, words: Sequence[str]) -> int:
    from arm_emulator.cli.arguments import BadArguments, run_with, write_page

    if set(HELP) & set(words):
        page = write_page(command)
        output.print_line(page)
        output.add_facts({"help": page})
        return 0
    try:
        return run_with(command, words)
    except BadArguments as bad:
        return _print_refusal(f"arm_emulator {command.name}: {bad}")
    except Exception as error:
        return _print_refusal(_translate_error(command.name, error))


def _translate_error(name: str, error: Exception) -> Refusal:
    """Return why a command cannot be imported or go on; raise again what is a mistake in it."""
    if isinstance(error, Refusal):
        return error
    if isinstance(error, ModuleNotFoundError):
        return _refuse_missing_module(name, error)
    if isinstance(error, BrokenPipeError) or not is_out_of_memory(error):
        raise error
    return Refusal("arm_emulator", "memory", "suffice", repr(error))


def _print_refusal(reason: Refusal | str) -> int:
    """Print a refusal, for people and for programs, and return the exit code."""
    try:
        print(reason, file=sys.stderr, flush=True)
    except OSError:
        drop_descriptor(2)
    output.add_facts({"refused": str(reason)})
    return 2


def _is_pipe_closed() -> bool:
    """Return whether the reader of our output, such as `head`, has ended."""
    poll = select.poll()
    poll.register(1, 0)
    return any(event & select.POLLERR for _, event in poll.poll(0))


def _refuse_missing_module(where: str, missing: ModuleNotFoundError) -> Refusal:
    """Return which package is missing, and the remedy."""
    top = (missing.name or "").partition(".")[0]
    if not top or top == "arm_emulator":
        raise missing
    of_ros = top in ROS_MODULES or top.endswith(("_msgs", "_srvs", "_interfaces"))
    if not of_ros:
        return refuse_missing_module(where, top)
    quantity = f"ROS 2, with its Python module {top},"
    return Refusal(where, quantity, "be installed", "none", ROS_REMEDY)


def _answer_without_command(words: Sequence[str]) -> int:
    """Print help or the version, or refuse a command that does not exist."""
    if not words or words[0] in HELP:
        output.print_line(_render_overview())
        output.add_facts({"commands": {name: read_summary(name) for name in command_names()}})
    elif words[0] == "--version":
        from arm_emulator.version import VERSION

        output.print_line(f"arm_emulator {VERSION}")
        output.add_facts({"version": VERSION})
    elif (package := find_package_of_command(words[0])) is not None:
        return _print_refusal(refuse_missing_package(words[0], package))
    else:
        similar = difflib.get_close_matches(words[0], command_names())
        near = (
            f"; did you mean {' or '.join(similar)}?"
            if similar
            else "; `arm_emulator --help` lists them"
        )
        return _print_refusal(f"arm_emulator: unknown command {words[0]}{near}")
    return 0


def _render_overview() -> str:
    groups = "\n\n".join(
        "\n".join([f"{group}:", *(f"  {name:<14} {read_summary(name)}" for name in names)])
        for group, names in command_groups().items()
    )
    return f"""\
An industrial arm, emulated.

usage: arm_emulator COMMAND ...
       arm_emulator COMMAND --help
       arm_emulator --version

{groups}"""
