"""The page's token: the same for a user's pages, unknown to others."""

from __future__ import annotations

from pathlib import Path

import pytest

from arm_emulator.build.library_cache import CACHE_VARIABLE
from arm_emulator.page.entrance import is_at_entrance
from arm_emulator.page.page_token import NAME, page_token


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return tmp_path / NAME


def test_a_token_is_kept_for_its_user_alone(file: Path) -> None:
    token = page_token()
    assert len(token) > 20 and page_token() == token == file.read_text()
    assert file.stat().st_mode & 0o777 == 0o600
    assert [one.name for one in file.parent.iterdir()] == [NAME]
    file.unlink()
    assert page_token() != token


@pytest.mark.parametrize("how", ["readable", "short", "link", "folder"])
def test_a_file_that_is_not_a_secret_is_not_used(file: Path, how: str, tmp_path: Path) -> None:
    token = page_token()
    match how:
        case "readable":
            file.chmod(0o644)
        case "short":
            file.write_text("")
        case "link":
            file.rename(tmp_path / "other")
            file.symlink_to(tmp_path / "other")
        case _:
            file.unlink()
            file.mkdir()
    fresh = page_token()
    assert fresh != token and len(fresh) == len(token) and page_token() != fresh


def test_browsers_come_in_by_the_entrance_once() -> None:
    assert is_at_entrance("/?token=x") and is_at_entrance("/")
    assert not is_at_entrance("/?token=x&look=dark&darkMode=") and not is_at_entrance("/a.js")
