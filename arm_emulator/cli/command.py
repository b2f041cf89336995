"""Commands register themselves: a module of `commands` each, imported when it is named."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import NamedTuple, TypeVar

FOLDER = os.path.join(os.path.dirname(__file__), "commands")
GROUPS = {
    "Drive an arm": ("demo", "up", "move", "status", "run"),
    "Records": (
        "record", "look", "explain", "check-bag", "replay", "fork", "foxglove", "repair",
    ),
    "Scenes and servos": ("new", "check-scene", "tune", "bode", "advise", "identify"),
    "Studies": ("campaign", "faults", "validate"),
    "Doors": (
        "tcp", "udp", "unix-socket", "firmware", "servo-header", "ethercat", "canopen", "modbus",
        "fmu", "ros2-control", "moveit-config",
    ),
    "This machine": ("doctor", "latency", "compile", "cache", "completion"),
}  # fmt: skip
Function = TypeVar("Function", bound=Callable[..., int])


class Command(NamedTuple):
    """One command.

    Attributes:
        name: on the command line.
        function: implementation; its parameters are the arguments, its result the exit code.
        until_stopped: Ctrl-C is its usual end, with exit code 0.
        keys: those of its object after `--json`, for the page: each between backquotes, and what
            they are where a name does not suffice.
    """

    name: str
    function: Callable[..., int]
    until_stopped: bool
    keys: str


_registered: dict[str, Command] = {}


def command(*, keys: str, until_stopped: bool = False) -> Callable[[Function], Function]:
    """Register a function as the command named after its module; arguments as of `Command`."""

    def register(function: Function) -> Function:
        name = function.__module__.rpartition(".")[2].replace("_", "-")
        _registered[name] = Command(name, function, until_stopped, keys)
        return function

    return register


def command_names() -> list[str]:
    """Return the names of all commands, sorted; imports none of them."""
    return sorted(name for group in GROUPS.values() for name in group)


def summary_of(name: str) -> str:
    """Return the first line of a command's module; imports nothing."""
    with open(os.path.join(FOLDER, f"{name.replace('-', '_')}.py"), encoding="utf-8") as file:
        return file.readline().strip().strip('"').removesuffix(".")


def load_command(name: str) -> Command | None:
    """Import a command and return it, None if it does not exist."""
    if name not in command_names():
        return None
    importlib.import_module(f"{__package__}.commands.{name.replace('-', '_')}")
    return _registered[name]
