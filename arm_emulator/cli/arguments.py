"""Parsing, help and completion of a command's arguments by cyclopts."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Literal, get_args, get_origin

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError
from cyclopts.argument import Argument

from arm_emulator.cli.command import Command, command_names, load_command
from arm_emulator.cli.options import Json

COLUMN = 24  # of an explanation
DEFAULTS = Parameter(negative=(), consume_multiple=(1, None), json_list=False, json_dict=False)


class BadArguments(Exception):
    """Arguments that a command refuses; the text is one line."""


def run_with(one: Command, words: Sequence[str]) -> int:
    """Run a command with its arguments, and return its exit code.

    Raises:
        BadArguments: the arguments are invalid.
    """
    try:
        function, given, _ = _app(one).parse_args(words, print_error=False, exit_on_error=False)
    except UnusedCliTokensError as error:
        raise BadArguments(f"unexpected argument {' '.join(error.unused_tokens or ())}") from None
    except CycloptsError as error:
        reason = " ".join(str(error).split())
        raise BadArguments(reason[:1].lower() + reason[1:].removesuffix(".")) from None
    if given.kwargs.pop("json", False):  # the option itself is no word any more
        raise BadArguments("--json takes no value")
    return int(function(*given.args, **given.kwargs))


def page_of(one: Command) -> str:
    """Return the help page of a command."""
    arguments = [
        argument
        for argument in _app(one).assemble_argument_collection(parse_docstring=True)
        if not argument.children  # which stand for it
    ]
    text = inspect.getdoc(one.function) or ""
    positional = [_shown(argument) for argument in arguments if _is_positional(argument)]
    usage = " ".join(["usage: arm_emulator", one.name, *positional, "[OPTIONS]"])
    lines = [usage, "", text.partition("\n\n")[0], ""]
    return "\n".join([*lines, *map(_explained, arguments), _row("-h, --help", "show this")])


def completion_script(shell: Literal["bash", "zsh", "fish"]) -> str:
    """Return the script that completes all commands and their options in a shell."""
    app = App(name="arm_emulator", default_parameter=DEFAULTS)
    for name in command_names():
        one = load_command(name)
        assert one is not None, name
        app.command(_with_json(one.function), name=name)
    return app.generate_completion(prog_name="arm_emulator", shell=shell)


def _app(one: Command) -> App:
    app = App(name=one.name, help_flags=(), version_flags=(), default_parameter=DEFAULTS)
    app.default(_with_json(one.function))
    return app


def _with_json(function: Callable[..., int]) -> Callable[..., int]:
    """Return a command's function with the option that all commands have."""
    plain = inspect.signature(function)
    kind = inspect.Parameter.KEYWORD_ONLY
    json = inspect.Parameter("json", kind, default=False, annotation=Json)

    @functools.wraps(function)
    def run(*given: object, **named: object) -> int:
        return function(*given, **named)

    run.__signature__ = plain.replace(parameters=[*plain.parameters.values(), json])  # type: ignore[attr-defined]
    run.__annotations__ = {**function.__annotations__, "json": Json}
    return run


def _is_positional(argument: Argument) -> bool:
    return not argument.name.startswith("-")


def _shown(argument: Argument) -> str:
    name = argument.parameter.metavar or argument.name.upper()
    if argument.field_info.kind is inspect.Parameter.VAR_POSITIONAL:
        return f"[{name} ...]"
    return name if argument.field_info.required else f"[{name}]"


def _explained(argument: Argument) -> str:
    head = argument.name
    hint = argument.hint
    choices = get_args(hint) if get_origin(hint) is Literal else ()
    if _is_positional(argument):
        head = argument.parameter.metavar or argument.name.upper()
    elif choices:
        head += f" {{{','.join(map(str, choices))}}}"
    elif hint is not bool:
        head += f" {argument.parameter.metavar or getattr(hint, '__name__', 'VALUE').upper()}"
    default = argument.field_info.default
    text = (argument.parameter.help or "").removesuffix(".")
    if default not in (None, inspect.Parameter.empty, False, "", ()):
        text += f" (default: {default})"
    elif argument.field_info.required and not _is_positional(argument):
        text += " (required)"
    return _row(head, text)


def _row(head: str, text: str) -> str:
    gap = f"\n{' ' * COLUMN}" if len(head) > COLUMN - 4 else " " * (COLUMN - 2 - len(head))
    return f"  {head}{gap}{' '.join(text.split())}"
