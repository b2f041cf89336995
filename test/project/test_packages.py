"""Packages are found by their entry points; the core without them names what is missing."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from documents import ROOT, page_of

from arm_emulator import Plant, Refusal
from arm_emulator.base import packages
from arm_emulator.cli import command_line
from arm_emulator.cli.command import command_groups, load_command
from arm_emulator.page.page_process import PageProcess


def test_a_page_without_its_package_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "find_entries", lambda _: {})
    words = r"page: package arm_emulator_page must be installed, got none; valid: `make setup`"
    with pytest.raises(Refusal, match=words):
        PageProcess(Plant("three_axis"), 0)
    PageProcess(Plant("three_axis"), None).close()


def test_the_core_alone_has_its_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("arm_emulator.cli.command.find_entries", lambda _: {})
    names = {name for group in command_groups().values() for name in group}
    assert {"demo", "up", "run", "new", "tune"} <= names and "ethercat" not in names
    assert load_command("run") is not None and load_command("ethercat") is None


def test_a_command_without_its_package_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("arm_emulator.cli.command.find_entries", lambda _: {})
    monkeypatch.setattr("sys.argv", ["arm_emulator", "bode", "ur5"])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    assert ended.value.code == 2
    assert capsys.readouterr().err == (
        "bode: package arm_emulator_analysis must be installed, got none; "
        "valid: `make setup` or pip install '.[analysis]' in a checkout of arm_emulator\n"
    )


def test_the_core_knows_which_package_has_which_command() -> None:
    commands_of: dict[str, list[str]] = {}
    for file in sorted((ROOT / "packages").glob("arm_emulator_*/*/commands/[!_]*.py")):
        package = file.parts[-3].removeprefix("arm_emulator_")
        commands_of.setdefault(package, []).append(file.stem.replace("_", "-"))
    assert {name: tuple(of) for name, of in commands_of.items()} == packages.COMMANDS_OF


def test_the_package_of_the_page_adds_its_command(tmp_path: Path) -> None:
    text = page_of("contribute/extending").read_text().split("### A package in a repository")[1]
    project, module = re.findall(r"^```\w+\n(.*?)^```$", text.split("\n## ")[0], re.M | re.S)
    package = tmp_path / "my_arm_tools"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "joint_names.py").write_text(module)
    (tmp_path / "pyproject.toml").write_text(project)

    path = os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", "")))

    def run(folder: Path, *arguments: str) -> str:
        command, env = (sys.executable, *arguments), {**os.environ, "PYTHONPATH": path}
        return subprocess.run(
            command, capture_output=True, text=True, check=True, cwd=folder, env=env
        ).stdout

    run(tmp_path, "-c", "import setuptools; setuptools.setup()", "-q", "egg_info")
    assert run(ROOT, "-m", "arm_emulator", "joint-names", "three_axis") == "waist shoulder elbow\n"
