"""The page is opened by its token alone, under its own address, from its own origin."""

from __future__ import annotations

import socket

import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.page.guard import COOKIE, Guard
from arm_emulator.page.page_address import PageAddress

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


@pytest.mark.parametrize(("text", "host", "port"), [
    (0, "127.0.0.1", 0), ("8080", "127.0.0.1", 8080), ("0.0.0.0:80", "0.0.0.0", 80),
    ("[::1]:8080", "::1", 8080), ("arm.local:1", "arm.local", 1),
])  # fmt: skip
def test_an_address_is_a_port_and_perhaps_a_host(text: str | int, host: str, port: int) -> None:
    assert PageAddress.of(text) == PageAddress(host, port)


@pytest.mark.parametrize("text", ["", "host", "host:", "1:x", "70000", "-1", "127.0.0.1:70000"])
def test_other_addresses_are_refused(text: str) -> None:
    with pytest.raises(Refusal, match=r"must be \[HOST:\]PORT|port must be"):
        PageAddress.of(text)


def test_a_host_of_another_machine_and_a_taken_port_are_refused() -> None:
    with pytest.raises(Refusal, match="host must be of this machine"):
        PageAddress.of("192.0.2.1:0").free()  # of documentation, RFC 5737
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(Refusal, match=f"port must be free, got {port}"):
            PageAddress.of(port).free()


def test_a_page_for_other_machines_is_asked_for_by_addresses_and_by_its_own_name() -> None:
    every = PageAddress.of("0.0.0.0:0")
    assert all(map(every.is_asked_by, ("192.168.1.5", "fe80::1", "localhost", every.name)))
    assert not any(map(every.is_asked_by, ("evil.example", "192.168.1.5.evil.example", "", None)))
    one = PageAddress.of("192.168.1.5:0")
    assert one.is_asked_by("192.168.1.5") and not one.is_asked_by("192.168.1.6")
    assert Guard(TOKEN, one).reason(f"/?token={TOKEN}", {"Host": "192.168.1.5:80"}) == ""
    assert "token" in Guard(TOKEN, one).reason("/", {"Host": "192.168.1.5:80"})
