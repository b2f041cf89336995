"""Commands register themselves: a module of `commands` is imported when its command is run."""

from __future__ import annotations

import difflib
import importlib
import os
from collections.abc import Callable
from typing import NamedTuple, TypeVar

FOLDER = os.path.join(os.path.dirname(__file__), "commands")
Function = TypeVar("Function", bound=Callable[..., int])


class Command(NamedTuple):
    """One command.

    Attributes:
        name: on the command line.
        function: implementation; its parameters are the arguments, its result the exit code.
        until_stopped: Ctrl-C is its usual end, with exit code 0.
        of_ros: it needs ROS 2.
    """

    name: str
    function: Callable[..., int]
    until_stopped: bool
    of_ros: bool


_registered: dict[str, Command] = {}


def command(*, until_stopped: bool = False, of_ros: bool = False) -> Callable[[Function], Function]:
    """Register a function as the command named after its module."""

    def register(function: Function) -> Function:
        name = function.__module__.rpartition(".")[2].replace("_", "-")
        _registered[name] = Command(name, function, until_stopped, of_ros)
        return function

    return register


def command_names() -> list[str]:
    """Return the names of all commands, sorted; imports none of them."""
    files = (file for file in os.listdir(FOLDER) if file.endswith(".py") and file[0] != "_")
    return sorted(file.removesuffix(".py").replace("_", "-") for file in files)


def summary_of(name: str) -> str:
    """Return the first line of a command's module; imports nothing."""
    with open(os.path.join(FOLDER, f"{name.replace('-', '_')}.py"), encoding="utf-8") as file:
        return file.readline().strip().strip('"').removesuffix(".")


def load_command(name: str) -> Command | None:
    """Import a command, and nothing else; None: the command does not exist."""
    if name not in command_names():
        return None
    importlib.import_module(f"arm_emulator.cli.commands.{name.replace('-', '_')}")
    return _registered[name]


def near_names(name: str, known: list[str]) -> str:
    """Return `; did you mean ...?`, or "" if no known name is near."""
    near = difflib.get_close_matches(name, known, n=3)
    return f"; did you mean {' or '.join(near)}?" if near else ""
