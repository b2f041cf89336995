"""Commands and programs on the pages: run here, or checked and listed with the reason.

Shell stands in fences of `sh`, Python in fences of `python`. A command of ours is read by its own
parser, so that no page names an option or a command that has gone; files, modules, targets of make
and types of messages must exist.
"""

import functools
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from documents import DOCUMENTS, ROOT

from arm_emulator.cli.arguments import run_with, write_page
from arm_emulator.cli.command import load_command
from arm_emulator.cli.command_line import main

NOT_RUN = {"--clear", "--help", "--page", "--servo"}  # with these they do not end, or do more
# Why these are read by their parser alone, beside those that run until Ctrl-C. Others end by
# themselves within seconds, need nothing that a page has not made, and run.
OURS = {
    "accuracy": "a quarter of a minute; test_accuracy.py",
    "advise": "minutes; test_advice.py",
    "campaign": "a minute; test_campaign.py",
    "fork": "needs a bag of before; test_fork_command.py",
    "check-bag": "needs the reader's bag; test_bags.py",
    "compile": "a minute of compilation for a level of processors; test_library_cache.py",
    "demo": "three processes; test_demo.py",
    "doctor": "its outcome is that of the machine; test_doctor.py",
    "ethercat": "needs a network interface; test_ethercat.py",
    "explain": "needs the reader's bags; test_recorded_machine.py",
    "firmware": "needs a cross compiler; test/peers",
    "identify": "needs the reader's record; test_identification.py",
    "move": "needs a network; test_move.py",
    "new": "needs the reader's robot; test_new.py",
    "latency": "its outcome is that of the machine; test_latency.py",
    "moveit-config": "half a minute of compilation; test_json.py",
    "record": "needs a network; test_bags.py",
    "repair": "needs a damaged bag; test_repair.py",
    "replay": "needs a bag; test_bags.py",
    "ros2-control": "half a minute of compilation; test_json.py",
    "status": "needs a network; test_move.py",
    "tune": "minutes; test_tune.py",
    "validate": "minutes; test_validation.py",
}
# Programs of others, which this machine need not have, and steps of a shell.
OTHERS = {
    **dict.fromkeys(("apt", "colcon", "pip", "rosdep"), "installs"),
    **dict.fromkeys(("callgrind_annotate", "gdb", "perf", "valgrind"), "a tool of the reader"),
    **dict.fromkeys(("ip", "sudo"), "needs root"),
    "cc": "an example in C; test_library_examples.py builds it",
    **dict.fromkeys(
        (".", "c++", "cat", "cc", "cd", "cp", "echo", "export", "git", "grep", "ulimit"),
        "shell",
    ),
    "launch_test": "of ROS; test/peers/test_launch_testing.py",
    "pytest": "a test of its own",
    **dict.fromkeys(("rerun", ".venv/bin/rerun"), "opens a window"),
    "ros2": "no wheel has it; types of messages are checked",
}
PROGRAMS = {*OTHERS, "arm_emulator", "make", "python"}
# Files that a reader writes or gets on the way.
THEIRS = {"my_crash.py", "steps.py"}
# Fences of Python that are not run as they stand: those of a page with a module that they import.
PYTHON = {
    "your_servo.md": ("rclpy", "needs a network; test_examples.py runs the file that it shows"),
    "by_hand.md": ("rclpy", "needs a network; test_by_hand.py"),
    "extending.md": ("@command", "a module of its own; test_packages.py makes its package"),
    "campaigns.md": ("polars", "a library of the reader, and results that a reader has"),
}
# Pages whose programs compile machines of their own, for seconds.
LONG = {
    "device.md",
    "ethercat.md",
    "fleet.md",
    "identify.md",
    "many_arms.md",
    "rewind.md",
    "sensitivities.md",
}
# Programs of masters, indented on their pages since a test in test/peers reads them there.
MASTERS = {"canopen.md", "ethercat.md", "modbus.md"}
MAKEFILES = (
    "Makefile",
    "arm_emulator/servo/c/template/Makefile",
    "packages/arm_emulator_firmware/arm_emulator_firmware/examples/stm32f4_like/Makefile",
)
TOP = {path.name for path in ROOT.iterdir() if path.name[0] != "."} - {"out", "build", "log"}


def fences(kind: str) -> list[tuple[Path, str]]:
    """Return page and text of each fence of a kind."""
    pattern = rf"^[ ]*```{kind}\n(.*?)^[ ]*```$"
    return [
        (page, match)
        for page in DOCUMENTS
        for match in re.findall(pattern, page.read_text(), re.M | re.S)
    ]


def lines_of(shell: str) -> Iterator[str]:
    """Yield whole commands: continued lines and quotes joined, texts for `<<` left out."""
    shell = re.sub(r"<<'(\w+)'\n.*?^\1$", "", shell, flags=re.M | re.S)
    unfinished = ""
    for line in shell.replace("\\\n", " ").split("\n"):
        unfinished = f"{unfinished}\n{line}" if unfinished else line
        try:
            shlex.split(unfinished, comments=True)
        except ValueError:  # a quote that goes on
            continue
        if unfinished.strip() and not unfinished.lstrip().startswith("#"):
            yield unfinished
        unfinished = ""
    assert not unfinished, f"a quote without end: {unfinished}"


def commands_of(line: str) -> Iterator[list[str]]:
    """Yield the words of each command of a line; values that are set before it are left out."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=";&|<>")
    lexer.whitespace_split = True
    words: list[str] = []
    for token in [*lexer, ";"]:
        if set(token) <= set(";&|"):
            while words and re.match(r"\w+=", words[0]):
                words = words[1:]
            if words:
                yield words
            words = []
        else:
            words.append(token)


def shell_commands() -> list[Any]:
    """Return every command of every page."""
    return [
        pytest.param(words, id=f"{page.name}: {' '.join(words)[:60]}")
        for page, text in fences("sh")
        for line in lines_of(text)
        for words in commands_of(line)
    ]


def ours(words: list[str]) -> list[str] | None:
    """Return the words behind our program's name, if a command is one of ours."""
    words = words[: words.index(">")] if ">" in words else words
    if words[:3] == ["python", "-m", "arm_emulator"]:
        return words[3:]
    return words[1:] if words[0] == "arm_emulator" else None


@functools.cache
def runs_here(name: str) -> bool:
    """Return whether a word is a command that is run here."""
    command = load_command(name)
    return command is not None and not command.until_stopped and name not in OURS


def check_ours(words: list[str]) -> None:
    """Let the command's own parser read it; usage lines, with [...], name known options."""
    if not words or words[0] in ("COMMAND", "--version", "--help"):
        return
    command = load_command(words[0])
    assert command is not None, f"no command {words[0]}"
    if any(set(word) & set("[]") for word in words):
        help_text = write_page(command)
        for option in re.findall(r"--[a-z-]+", " ".join(words)):
            assert option in help_text, option
        return

    @functools.wraps(command.function)
    def nothing(*_: Any, **__: Any) -> int:
        return 0

    arguments = [word for word in words[1:] if word != "--json"]  # which all commands have
    assert run_with(command._replace(function=nothing), arguments) == 0


def on_pages() -> set[str]:
    """Return the first words behind our program's name on all pages."""
    return {words[0] for param in shell_commands() if (words := ours(param.values[0]))}


def check_python(words: list[str]) -> None:
    """The module or the file of a call of Python exists."""
    if words[1] == "-m":
        assert (ROOT / (words[2].replace(".", "/") + ".py")).exists() or (
            ROOT / words[2].replace(".", "/") / "__main__.py"
        ).exists(), words[2]
    elif words[1] != "-c":
        assert words[1] in THEIRS or (ROOT / words[1]).exists(), words[1]


def check_make(words: list[str]) -> None:
    """The targets of a call of make are those of one Makefile, ours or an example's."""
    targets = {word for word in words[1:] if "=" not in word}
    makefiles = [
        set(re.findall(r"^([a-z][\w-]*):", (ROOT / makefile).read_text(), re.M))
        for makefile in MAKEFILES
    ]
    assert any(targets <= makefile for makefile in makefiles), targets


@pytest.mark.parametrize("words", shell_commands())
def test_a_command_on_a_page_exists(words: list[str]) -> None:
    mine = ours(words)
    if mine is not None:
        check_ours(mine)
    elif words[0] == "python":
        check_python(words)
    elif words[0] == "make":
        check_make(words)
    else:
        assert words[0] in OTHERS, f"neither run nor listed: {words[0]}"
    for word in words:
        first = word.split("/")[0]
        if "/" in word and first in TOP and not set(word) & set("*[]$"):
            assert (ROOT / word).exists(), word
        message_type = re.fullmatch(r"arm_emulator_msgs/(?:(srv)|msg)/(\w+)", word)
        if message_type:
            kind = "srv" if message_type[1] else "msg"
            assert (
                ROOT / "msg" / (message_type[1] or "") / f"{message_type[2]}.{kind}"
            ).exists(), word


@pytest.mark.slow
def test_commands_that_end_soon_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for name in ("config", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    ran = set()
    for param in shell_commands():
        words = ours(param.values[0])
        if not words or not runs_here(words[0]) or NOT_RUN & set(words):
            continue
        if any(re.search(r"[\[\]]|\b[A-Z_]{4,}\b|my_", word) for word in words):
            continue  # for the reader to fill in
        monkeypatch.setattr(sys, "argv", ["arm_emulator", *words])
        with pytest.raises(SystemExit) as end:
            main()
        assert not end.value.code, f"{param.id}: {capfd.readouterr().err}"
        ran.add(words[0])
    assert ran == {name for name in on_pages() if runs_here(name)}, "list why others are not run"


def test_shell_and_python_stand_in_fences() -> None:
    for page in DOCUMENTS:
        text = re.sub(r"^[ ]*```.*?^[ ]*```$", "", page.read_text(), flags=re.M | re.S)
        for block in re.findall(r"(?<=\n\n)    (\S.*)", text):
            assert block.split()[0] not in PROGRAMS, f"{page.name}: {block}"
            assert page.name in MASTERS or not re.match(r"(import|from) \w", block), block


def python_fences() -> list[Any]:
    counts: dict[str, int] = {}
    blocks = []
    for page, text in fences("python"):
        counts[page.name] = counts.get(page.name, -1) + 1
        if page.name not in PYTHON or PYTHON[page.name][0] not in text:
            marks = [pytest.mark.slow] if page.name in LONG else []
            blocks.append(pytest.param(text, id=f"{page.name}-{counts[page.name]}", marks=marks))
    return blocks


@pytest.mark.parametrize("block", python_fences())
def test_python_runs(block: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    if "@register_part" in block:  # of a process whose scenes have not been read yet
        subprocess.run([sys.executable, "-c", block], check=True)
        return
    names: dict[str, Any] = {}
    exec(block, names)
    if "target" in names:
        # Half a count of the encoders each, and one and a half with w = 0.5: 0.1 mm at this arm.
        deviation = names["target"].p_WT - names["kinematics"].forward(names["plant"].state.q)[1]
        assert (deviation @ deviation) ** 0.5 < 1e-4


def test_the_lists_have_nothing_that_no_page_needs() -> None:
    used = {param.values[0][0] for param in shell_commands()}
    assert set(OTHERS) <= used | {"pytest"}, set(OTHERS) - used
    assert OURS.keys() <= on_pages(), OURS.keys() - on_pages()
    needed = {
        page.name
        for page, text in fences("python")
        if page.name in PYTHON and PYTHON[page.name][0] in text
    }
    assert needed == set(PYTHON)
