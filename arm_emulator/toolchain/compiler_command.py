"""The C++ compiler of this machine."""

import os
import re
import shlex
import shutil

from arm_emulator.base.refusal import Refusal

# The name of a compiler may begin with the system it compiles for: x86_64-linux-gnu-g++-12.
_NAME = re.compile(r"([\w.]+-)*(c\+\+|g\+\+|clang(\+\+)?|ptxas)(-[\d.]+)?")


def find_compiler() -> list[str]:
    """Return the C++ compiler's command: $CXX, or the first of c++, g++, clang++ on the path.

    Raises:
        Refusal: no compiler was found, or $CXX is no command.
    """
    named = read_command("CXX")
    for words in [named] if named else [["c++"], ["g++"], ["clang++"]]:
        if shutil.which(words[0]):
            return words
    raise Refusal(
        "arm_emulator",
        "C++ compiler",
        "be on the path, a scene is compiled when first used",
        named[0] if named else "none of c++, g++, clang++",
        "install one, set CXX, or compile ahead with `arm_emulator compile SCENE` elsewhere",
    )


def is_compiler_named() -> bool:
    """Whether $CXX names the compiler.

    Raises:
        Refusal: $CXX is no command.
    """
    return bool(read_command("CXX"))


def is_compiler_alone(command: list[str]) -> bool:
    """Whether a command is a compiler alone: without options, and no program that calls one."""
    return len(command) == 1 and bool(_NAME.fullmatch(os.path.basename(_find_program(command[0]))))


def identify_compiler(command: list[str]) -> str:
    """Return a compiler's command with its actual program, as g++-12 for c++."""
    return shlex.join([_find_program(command[0]), *command[1:]])


def _find_program(name: str) -> str:
    """Return the file behind a name, through links whose targets are named as compilers."""
    file = shutil.which(name) or name
    while os.path.islink(file):
        target = os.path.normpath(os.path.join(os.path.dirname(file), os.readlink(file)))
        base = os.path.basename(target)
        if "++" not in base and "clang" not in base:
            break  # a program that goes by the name of many compilers, as ccache
        file = target
    return file


def read_command(variable: str) -> list[str]:
    """Return the words of a command that an environment variable names; none if it is not set.

    Raises:
        Refusal: it is no command.
    """
    text = os.environ.get(variable, "")
    try:
        return shlex.split(text)
    except ValueError as error:
        raise Refusal(
            "arm_emulator", variable, "be the words of a command", f"{text} ({error})"
        ) from None
