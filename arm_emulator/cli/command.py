"""Commands register themselves: a module of `commands` each, imported when its command runs."""

from __future__ import annotations

import difflib
import functools
import importlib
import os
from collections.abc import Callable
from typing import NamedTuple, TypeVar, get_type_hints

FOLDER = os.path.join(os.path.dirname(__file__), "commands")
# A declaration is a command's function without its body; these modules suffice for it.
OF_DECLARATIONS = ("arm_emulator.base.kept", "arm_emulator.cli.command", "arm_emulator.cli.options",
                   "cyclopts", "pathlib", "typing")  # fmt: skip
Function = TypeVar("Function", bound=Callable[..., int])


class Command(NamedTuple):
    """One command.

    Attributes:
        name: on the command line.
        function: implementation; its parameters are the arguments, its result the exit code.
        until_stopped: Ctrl-C is its usual end, with exit code 0.
        of_ros: it needs ROS 2.
        keys: those of its object after `--json`, for the page: each between backquotes, and what
            they are where a name does not suffice.
    """

    name: str
    function: Callable[..., int]
    until_stopped: bool
    of_ros: bool
    keys: str


_registered: dict[str, Command] = {}


def command(
    *, keys: str, until_stopped: bool = False, of_ros: bool = False
) -> Callable[[Function], Function]:
    """Register a function as the command named after its module; arguments as of `Command`."""

    def register(function: Function) -> Function:
        name = function.__module__.rpartition(".")[2].replace("_", "-")
        _registered[name] = Command(name, function, until_stopped, of_ros, keys)
        return function

    return register


def command_names() -> list[str]:
    """Return the names of all commands, sorted; imports none of them."""
    files = (file for file in os.listdir(FOLDER) if file.endswith(".py") and file[0] != "_")
    return sorted(file.removesuffix(".py").replace("_", "-") for file in files)


def summary_of(name: str) -> str:
    """Return the first line of a command's module; imports nothing."""
    with open(_file_of(name), encoding="utf-8") as file:
        return file.readline().strip().strip('"').removesuffix(".")


def load_command(name: str) -> Command | None:
    """Return a command, None if it does not exist.

    Its module is imported when it is called; at once if its head has a constant or a type of its
    own, which makes its help as slow as the command itself.
    """
    if name not in command_names():
        return None
    module = f"{__package__}.commands.{name.replace('-', '_')}"
    import ast

    def declares(one: ast.stmt) -> bool:
        """Whether a statement belongs to the declaration; a function of it loses its body."""
        if isinstance(one, ast.ImportFrom):
            return one.module == "__future__" or one.module in OF_DECLARATIONS
        if not (isinstance(one, ast.FunctionDef) and one.decorator_list):
            return False
        one.body = one.body[:1]  # its text
        return ast.unparse(one.decorator_list[0]).startswith("command(")

    with open(_file_of(name), encoding="utf-8") as file:
        tree = ast.parse(file.read())
    tree.body = [one for one in tree.body if declares(one)]
    try:
        exec(compile(tree, _file_of(name), "exec"), {"__name__": module})
        get_type_hints(_registered[name].function)
    except NameError:  # the head needs a name that the module defines or imports
        importlib.import_module(module)
    declared = _registered[name]

    @functools.wraps(declared.function)
    def run(*given: object, **named: object) -> int:
        work = getattr(importlib.import_module(module), declared.function.__name__)
        return int(work(*given, **named))

    return declared._replace(function=run)


def _file_of(name: str) -> str:
    return os.path.join(FOLDER, f"{name.replace('-', '_')}.py")


def near_names(name: str, known: list[str]) -> str:
    """Return `; did you mean ...?`, or "" if no known name is near."""
    near = difflib.get_close_matches(name, known, n=3)
    return f"; did you mean {' or '.join(near)}?" if near else ""
