"""Commands register themselves: a module each, which is imported when its command is named.

Those of the core stand in `commands`; packages beside it register theirs as entry points.
"""

import importlib
import importlib.util
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from arm_emulator.base.packages import COMMANDS, find_entries

GROUPS = {
    "Drive an arm": ("demo", "up", "move", "status", "run"),
    "Records": (
        "record", "check-bag", "replay", "fork", "repair",
    ),
    "Scenes and servos": ("new", "check-scene", "tune"),
    "Doors": ("tcp", "udp", "unix-socket", "servo-header"),
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

    def register_function(function: Function) -> Function:
        name = function.__module__.rpartition(".")[2].replace("_", "-")
        _registered[name] = Command(name, function, until_stopped, keys)
        return function

    return register_function


def command_groups() -> dict[str, tuple[str, ...]]:
    """Return the names of all commands by heading; imports none of them."""
    groups = dict(GROUPS)
    for name, point in find_entries(COMMANDS).items():
        package = point.module.partition(".")[0]
        groups[package] = (*groups.get(package, ()), name)
    return groups


def command_names() -> list[str]:
    """Return the names of all commands, sorted; imports none of them."""
    return sorted(name for group in command_groups().values() for name in group)


def read_summary(name: str) -> str:
    """Return the first line of a command's module, which is not imported."""
    module = importlib.util.find_spec(_find_module(name) or "")
    assert module is not None and module.origin is not None, name
    with open(module.origin, encoding="utf-8") as file:
        return file.readline().strip().strip('"').removesuffix(".")


def load_command(name: str) -> Command | None:
    """Import a command and return it, None if it does not exist."""
    module = _find_module(name)
    if module is None:
        return None
    importlib.import_module(module)
    return _registered[name]


def _find_module(name: str) -> str | None:
    """Return the module of a command; packages are looked through for names unknown here alone."""
    if any(name in names for names in GROUPS.values()):
        return f"{__package__}.commands.{name.replace('-', '_')}"
    point = find_entries(COMMANDS).get(name)
    return None if point is None else point.module
