"""Packages are found by their entry points; the core without them names what is missing."""

from __future__ import annotations

import pytest

from arm_emulator import Plant, Refusal
from arm_emulator.base import packages
from arm_emulator.cli.command import command_groups, load_command
from arm_emulator.page.page_process import PageProcess


def test_a_page_without_its_package_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packages, "find_entries", lambda _: {})
    words = r"page: package arm_emulator_page must be installed, got none; valid: pip install "
    with pytest.raises(Refusal, match=words):
        PageProcess(Plant("three_axis"), 0)
    PageProcess(Plant("three_axis"), None).close()


def test_the_core_alone_has_its_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("arm_emulator.cli.command.find_entries", lambda _: {})
    names = {name for group in command_groups().values() for name in group}
    assert {"demo", "up", "run", "new", "tune"} <= names and "ethercat" not in names
    assert load_command("run") is not None and load_command("ethercat") is None
