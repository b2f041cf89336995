"""The command line as a whole: help, misspelled words, completion, what is imported before."""

import io
import random
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest
from documents import DOCUMENTS, ROOT
from draws import some, with_slow

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli import arguments, command_line
from arm_emulator.cli.command import Command, command_names, load_command
from arm_emulator.ros.process.ctrl_c import CtrlC

HEAVY = ("numpy", "scipy", "rclpy", "pinocchio", "matplotlib", "rosbags", "yaml", "rich",
         "cyclopts")  # fmt: skip


def run(*words: str) -> tuple[int, str, str]:
    """Run a command in this process; return its exit code and what it prints."""
    out, errors, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["arm_emulator", *words]
    try:
        with redirect_stdout(out), redirect_stderr(errors), pytest.raises(SystemExit) as ended:
            command_line.main()
    finally:
        sys.argv = before
    return ended.value.code, out.getvalue(), errors.getvalue()


def options_of(page: str) -> list[str]:
    return re.findall(r"^ (?:\*  |   )?(--\S+)", page, re.MULTILINE)


def commands() -> list[Command]:
    result = [load_command(name) for name in command_names()]
    return [figure for figure in result if figure is not None]


def test_help_lists_every_command_and_imports_none() -> None:
    words = [(), ("--help",), ("-h",)]
    pages = {run(*line) for line in words}
    assert len(pages) == 1, "a bare call is a call for help"
    code, page, errors = pages.pop()
    assert code == 0 and not errors
    listed = re.findall(r"^  (\S+)", page, re.MULTILINE)
    assert sorted(listed) == command_names()
    files = [
        *(ROOT / "arm_emulator/cli/commands").glob("[!_]*.py"),
        *(ROOT / "packages").glob("*/*/commands/[!_]*.py"),
    ]
    assert sorted(file.stem.replace("_", "-") for file in files) == command_names()


def test_help_is_there_before_anything_heavy() -> None:
    """The start-up time of the list of commands, as a busy machine cannot spoil it."""
    program = (
        "import sys; sys.argv[1:] = ['--help']\n"
        "from arm_emulator.__main__ import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code\n"
        f"print('LOADED', *[name for name in {HEAVY} if name in sys.modules])\n"
        "import arm_emulator.extension.machine\n"
        "print('scipy' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-2:] == ["LOADED", "False"], done.stdout


@pytest.mark.parametrize("command", commands(), ids=lambda command: command.name)
def test_every_argument_is_explained_and_every_command_has_a_page(command: Command) -> None:
    page = run(command.name, "--help")[1]
    rows = re.findall(r"^ (?:\*  |   )?((?:--|[A-Z]).*)", page, re.MULTILINE)
    assert rows[-1].startswith("--json ")
    for row in rows:
        assert re.match(r"\S.*  [^ \[]", row), f"{command.name}: {row}"
    text = f"arm_emulator {command.name}"
    assert any(text in page.read_text() for page in DOCUMENTS), command.name


def test_misspelled_words_are_refused_in_a_line_with_the_right_word() -> None:
    draw = random.Random(1)
    for command in commands():
        names = options_of(arguments.write_page(command))
        draw.shuffle(names)
        for name in some(names, 4):
            letters = list(name)
            at = draw.randrange(3, len(name)) if len(name) > 4 else 2
            letters.insert(at, draw.choice("qxz"))
            wrong = "".join(letters)
            code, out, errors = run(command.name, wrong)
            assert code == 2 and not out, (command.name, wrong)
            assert errors.startswith(f"arm_emulator {command.name}: ") and errors.count("\n") == 1
            required = "requires an argument" in errors  # which is missed first
            assert required or (wrong in errors and "Did you mean --" in errors), errors
        name = f"{command.name}q"
        code, out, errors = run(name)
        assert code == 2 and not out and errors.count("\n") == 1, errors
        assert f"unknown command {name}; did you mean" in errors and command.name in errors


BAD = {
    ("run", "--seconds", "x"): "--seconds",
    ("run", "--displacement", "0", "1"): "--displacement",
    ("run", "three_axis", "ur5"): "unexpected argument ur5",
    ("up", "--clock", "sundial"): "lockstep",
    ("fmu", "three_axis"): "--out",
    ("check-scene",): "SCENE",
    ("record", "bag", "--topics"): "--topics",
    ("cache", "--clear=maybe"): "maybe",
    ("modbus", "--clock", "sundial"): "lockstep",
    ("run", "--json=1"): "--json",
    ("canopen", "--bitrate", "1e3x"): "--bitrate",
    ("tune", "three_axis", "--out"): "--out",
    ("run", "--seconds", "1\n2"): "--seconds",
}


@pytest.mark.parametrize("words", BAD, ids=" ".join)
def test_bad_values_are_refused_in_a_line(words: tuple[str, ...]) -> None:
    code, out, errors = run(*words)
    assert code == 2 and not out and errors.count("\n") == 1, errors
    assert errors.startswith(f"arm_emulator {words[0]}: ") and BAD[words] in errors, errors


def test_a_refusal_and_a_missing_package_are_a_line_and_exit_code_2(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reasons = {
        Refusal("here", "x", "be 1", 2): "here: x must be 1, got 2\n",
        ModuleNotFoundError(name="rclpy.node"): "up: ROS 2, with its Python module rclpy, must be",
        ModuleNotFoundError(name="std_msgs"): "up: ROS 2, with its Python module std_msgs, must be",
        ModuleNotFoundError(name="can"): "up: Python module can must be installed, got none; valid",
        MemoryError(): "arm_emulator: memory must suffice",
    }
    for reason, words in reasons.items():

        def fail(*_: object, reason: Exception = reason) -> int:
            raise reason

        monkeypatch.setattr(arguments, "run_with", fail)
        code, out, errors = run("up")
        assert code == 2 and not out and errors.count("\n") == 1, errors
        assert errors.startswith(words), errors
    mistake = ModuleNotFoundError(name="arm_emulator.mistake")  # no package to install: our mistake
    monkeypatch.setattr(arguments, "run_with", lambda *_: (_ for _ in ()).throw(mistake))
    monkeypatch.setattr(sys, "argv", ["arm_emulator", "up"])
    with pytest.raises(ModuleNotFoundError):
        command_line.main()


def test_the_version_is_that_of_the_packages() -> None:
    code, printed, _ = run("--version")
    version = printed.split()[-1]
    assert code == 0 and printed.startswith("arm_emulator ")
    for file in ("package.xml", "msg/package.xml"):
        assert f"<version>{version}</version>" in (ROOT / file).read_text(), file


@pytest.mark.parametrize("count", ["2.5", "1e3", "nan", "inf", "-1.5", "2.", "x"])
def test_counts_are_integers(count: str) -> None:
    """A count that was rounded would be another one than was asked for."""
    code, _, errors = run("accuracy", "three_axis", "--edge", "20", "--cycles", count)
    line = "--edge must be" if count == "2." else f'unable to convert "{count}" into int'
    assert code == 2 and line in errors


SHELLS = {"bash": ["bash", "-n"], "zsh": ["zsh", "-n"], "fish": ["fish", "--no-execute"]}


@pytest.mark.parametrize("shell", with_slow(SHELLS, 1))
def test_completion_knows_every_command_and_option(shell: str, tmp_path: Path) -> None:
    code, script, errors = run("completion", shell)
    assert code == 0 and not errors
    for command in commands():
        assert command.name in script, command.name
        for option in options_of(arguments.write_page(command)):
            assert option.lstrip("-") in script, (command.name, option)
    file = tmp_path / "completion"
    file.write_text(script)
    try:
        subprocess.run([*SHELLS[shell], str(file)], check=True, capture_output=True)
    except FileNotFoundError:
        pytest.skip(f"{shell} is not installed")


def test_bash_completes_a_command_and_an_option(tmp_path: Path) -> None:
    file = tmp_path / "completion"
    file.write_text(run("completion", "bash")[1])
    complete = (
        f"source {file}; function_of=$(complete -p arm_emulator | sed 's/.*-F \\([^ ]*\\).*/\\1/');"
        "COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); $function_of; echo ${COMPREPLY[@]}"
    )
    for words, expected in ((["che"], "check-bag check-scene"), (["tune", "--pay"], "--payload")):
        line = " ".join(f"'{word}'" for word in ["arm_emulator", *words])
        done = subprocess.run(
            ["bash", "-c", f"COMP_WORDS=({line}); {complete}"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert done.stdout.split() == expected.split(), done


CLOSED_PIPE = """
import os, runpy, sys
import arm_emulator.cli.command_line  # which all of them import
for words in sys.stdin.read().splitlines():
    read, write = os.pipe()
    os.close(read)  # before the first word is printed
    errors, stderr = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(write, 1), os.dup2(stderr, 2)
        sys.argv = ["arm_emulator", *words.split()]
        runpy.run_module("arm_emulator", run_name="__main__")
    os.close(write), os.close(stderr)
    with os.fdopen(errors) as reader:
        stated = reader.read().strip()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    print(words, code, stated, sep="|", flush=True)
"""


WITHOUT_A_READER = {
    "shared": ["", "--help", "--version", "completion bash", "run --help", "canopen --help"],
    "of each": [f"{name} --help" for name in command_names()],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WITHOUT_A_READER)
def test_help_and_version_end_quietly_without_a_reader(name: str) -> None:
    lines = WITHOUT_A_READER[name]
    ended = subprocess.run(
        [sys.executable, "-c", CLOSED_PIPE], input="\n".join(lines), text=True,
        stdout=subprocess.PIPE, check=True,
    ).stdout.splitlines()  # fmt: skip
    assert ended == [f"{words}|141|" for words in lines], "as by SIGPIPE, without a traceback"


@pytest.fixture(autouse=True)
def no_signal() -> None:
    CtrlC.signal = 0
