"""The page is opened by its token alone, under its own address, from its own origin."""

from __future__ import annotations

import pytest

from arm_emulator.page.guard import COOKIE, Guard

TOKEN = "s3cret-token"
OWN = {"Host": "127.0.0.1:8765"}


@pytest.mark.parametrize(
    ("path", "headers", "reason"),
    [
        (f"/?token={TOKEN}", OWN, ""),
        ("/", {**OWN, "Cookie": f"{COOKIE}={TOKEN}"}, ""),
        ("/a.js", {**OWN, "Cookie": f"other=1; {COOKIE}={TOKEN}"}, ""),
        (f"/?token={TOKEN}", {"Host": "localhost:8765", "Origin": "http://localhost:8765"}, ""),
        (f"/?token={TOKEN}", {"Host": "[::1]:8765"}, ""),
        ("/", OWN, "token"),
        ("/?token=", OWN, "token"),
        ("/?token=other", OWN, "token"),
        (f"/?token={TOKEN}x", OWN, "token"),
        (f"/?token={TOKEN[:-1]}", OWN, "token"),
        ("/", {**OWN, "Cookie": f"{COOKIE}=other"}, "token"),
        ("/", {**OWN, "Cookie": f"x{COOKIE}={TOKEN}"}, "token"),
        ("/", {**OWN, "Cookie": "=;=;\x00"}, "token"),
        (f"/{TOKEN}", OWN, "token"),
        (f"/?token={TOKEN}", {}, "address"),
        (f"/?token={TOKEN}", {"Host": "evil.example:8765"}, "address"),
        (f"/?token={TOKEN}", {"Host": "127.0.0.1.evil.example"}, "address"),
        (f"/?token={TOKEN}", {"Host": "evil@127.0.0.2"}, "address"),
        (f"/?token={TOKEN}", {**OWN, "Origin": "http://evil.example"}, "another page"),
        (f"/?token={TOKEN}", {**OWN, "Origin": "http://127.0.0.1:9999"}, "another page"),
        (f"/?token={TOKEN}", {**OWN, "Origin": "null"}, "another page"),
    ],
)  # fmt: skip
def test_requests_are_judged(path: str, headers: dict[str, str], reason: str) -> None:
    found = Guard(TOKEN).reason(path, headers)
    assert (reason in found) if reason else not found, found


def test_the_cookie_is_set_where_the_token_came_and_no_script_or_other_page_gets_it() -> None:
    guard = Guard(TOKEN)
    cookie = guard.cookie(f"/?token={TOKEN}")
    assert cookie.startswith(f"{COOKIE}={TOKEN};")
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert guard.cookie("/") == "" == guard.cookie("/a.js?x=1")
