"""Parsing, help and completion of a command's arguments by cyclopts."""

import contextlib
import functools
import inspect
import io
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, get_args

from cyclopts import (
    App,
    CoercionError,
    CycloptsError,
    Parameter,
    Token,
    UnusedCliTokensError,
    convert,
)
from cyclopts.help import DefaultFormatter, PanelSpec
from rich.box import Box
from rich.console import Console

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import Command, command_names, load_command
from arm_emulator.cli.options import Json

WIDTH = 100  # of help
FRAMELESS = Box("    \n" * 8)


def _convert_whole(kind: Any, tokens: Sequence[Token]) -> Any:
    """Return the value of words; 2.5 is no whole number, which cyclopts would round to 2."""
    if int in (kind, *get_args(kind)):
        for token in tokens:
            with contextlib.suppress(ValueError):
                if not float(token.value).is_integer():
                    raise CoercionError(token=token, target_type=int)
    return convert(kind, tokens)


DEFAULTS = Parameter(
    converter=_convert_whole,
    negative=(),
    consume_multiple=(1, None),
    json_list=False,
    json_dict=False,
    show_default=lambda value: None if value in (None, False, "") else str(value),
)


class BadArguments(Exception):
    """Arguments that a command refuses; the text is one line."""


def run_with(command: Command, words: Sequence[str]) -> int:
    """Run a command with its arguments, and return its exit code.

    Raises:
        BadArguments: the arguments are invalid.
    """
    try:
        function, bound, _ = _build_app([command]).parse_args(
            [command.name, *words], print_error=False, exit_on_error=False
        )
    except UnusedCliTokensError as error:
        raise BadArguments(f"unexpected argument {' '.join(error.unused_tokens or ())}") from None
    except CycloptsError as error:
        reason = " ".join(str(error).split())
        raise BadArguments(reason[:1].lower() + reason[1:].removesuffix(".")) from None
    if bound.kwargs.pop("json", False):  # the option itself is no word any more
        raise BadArguments("--json takes no value")
    return int(function(*bound.args, **bound.kwargs))


def write_page(command: Command) -> str:
    """Return the help page of a command."""
    page = io.StringIO()
    _build_app([command]).help_print(
        [command.name], console=Console(file=page, width=WIDTH, no_color=True)
    )
    return "\n".join(line.rstrip() for line in page.getvalue().strip().splitlines())


def write_completion_script(shell: Literal["bash", "zsh", "fish"]) -> str:
    """Return the script that completes the commands and their options in a shell.

    Commands whose packages are not installed are left out.
    """
    every = list[Command]()
    for name in command_names():
        with contextlib.suppress(ModuleNotFoundError, Refusal):
            if command := load_command(name):
                every.append(command)
    return _build_app(every).generate_completion(prog_name="arm_emulator", shell=shell)


def _build_app(commands: Iterable[Command]) -> App:
    app = App(
        name="arm_emulator",
        help_flags=(),
        version_flags=(),
        help_format="markdown",
        help_formatter=DefaultFormatter(panel_spec=PanelSpec(box=FRAMELESS, padding=(0, 0))),
        default_parameter=DEFAULTS,
    )
    for command in commands:
        app.command(_add_json_option(command.function), name=command.name)
    return app


def _add_json_option(function: Callable[..., int]) -> Callable[..., int]:
    """Return a command's function with the option that all commands have."""
    plain = inspect.signature(function)
    kind = inspect.Parameter.KEYWORD_ONLY
    json = inspect.Parameter("json", kind, default=False, annotation=Json)

    @functools.wraps(function)
    def run_command(*positional: object, **named: object) -> int:
        return function(*positional, **named)

    run_command.__signature__ = plain.replace(parameters=[*plain.parameters.values(), json])  # type: ignore[attr-defined]
    run_command.__annotations__ = {**function.__annotations__, "json": Json}
    return run_command
