"""The page's token: a new one for each run, or the one that its launcher has printed."""

import os
import re

import pytest

from arm_emulator.page.page_address import VARIABLE, get_token, make_token
from arm_emulator_page.page_server import is_landing_page


def test_every_run_has_a_token_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    tokens = {get_token() for _ in range(100)}
    assert len(tokens) == 100
    assert all(re.fullmatch("[A-Za-z0-9_-]{22}", token) for token in tokens), "128 bits, for a path"


def test_the_token_of_a_launcher_serves_a_single_page(monkeypatch: pytest.MonkeyPatch) -> None:
    token = make_token()
    monkeypatch.setenv(VARIABLE, token)
    assert get_token() == token
    assert VARIABLE not in os.environ and get_token() != token


@pytest.mark.parametrize("weak", ["", "short", "../" + 30 * "a", 30 * "ä", 30 * "a" + "?x"])
def test_a_launcher_cannot_weaken_it(weak: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, weak)
    assert get_token() != weak


def test_browsers_come_in_by_the_entrance_once() -> None:
    assert is_landing_page("/?x=y") and is_landing_page("/")
    assert not is_landing_page("/?look=dark&darkMode=") and not is_landing_page("/a.js")
