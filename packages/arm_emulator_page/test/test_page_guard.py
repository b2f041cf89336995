"""The page is opened by its token alone, under its own address, from its own origin."""

import gzip
import socket
from types import SimpleNamespace

import numpy as np
import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.page.page_address import PageAddress
from arm_emulator_page.page_server import Guard, _put_title

TOKEN = "s3cret-token"
OWN = {"Host": "127.0.0.1:8765"}


@pytest.mark.parametrize(
    ("path", "headers", "status", "below"),
    [
        (f"/{TOKEN}/", OWN, 200, "/"),
        (f"/{TOKEN}", OWN, 200, "/"),
        (f"/{TOKEN}?look=dark", OWN, 200, "/?look=dark"),
        (f"/{TOKEN}/a/b.js?x=..", OWN, 200, "/a/b.js?x=.."),
        (f"/{TOKEN}/", {"Host": "localhost:8765", "Origin": "http://localhost:8765"}, 200, "/"),
        (f"/{TOKEN}/", {"Host": "[::1]:8765"}, 200, "/"),
        ("/", OWN, 403, "token"),
        ("/other/", OWN, 403, "token"),
        (f"/{TOKEN}x/", OWN, 403, "token"),
        (f"/{TOKEN[:-1]}/", OWN, 403, "token"),
        (f"/?token={TOKEN}", OWN, 403, "token"),
        (f"//{TOKEN}/", OWN, 403, "token"),
        ("/", {**OWN, "Cookie": f"arm_emulator_page={TOKEN}"}, 403, "token"),
        (f"/{TOKEN}/", {}, 403, "address"),
        (f"/{TOKEN}/", {"Host": "evil.example:8765"}, 403, "address"),
        (f"/{TOKEN}/", {"Host": "127.0.0.1.evil.example"}, 403, "address"),
        (f"/{TOKEN}/", {"Host": "evil@127.0.0.2"}, 403, "address"),
        (f"/{TOKEN}/", {**OWN, "Origin": "http://evil.example"}, 403, "another page"),
        (f"/{TOKEN}/", {**OWN, "Origin": "http://127.0.0.1:9999"}, 403, "another page"),
        (f"/{TOKEN}/", {**OWN, "Origin": "null"}, 403, "another page"),
        ("", OWN, 400, "malformed"),
        (TOKEN, OWN, 400, "malformed"),
        (f"http://127.0.0.1:8765/{TOKEN}/", OWN, 400, "malformed"),
        (f"/{TOKEN}/../../etc/passwd", OWN, 400, "malformed"),
        (f"/{TOKEN}/..", OWN, 400, "malformed"),
        (f"/{TOKEN}/\0", OWN, 400, "malformed"),
        (f"/{TOKEN}/\xff", OWN, 400, "malformed"),
        (f"/{TOKEN}\xff/", OWN, 400, "malformed"),
        (f"/{TOKEN}/", {"Host": "[::1"}, 400, "malformed"),
        (f"/{TOKEN}/", {**OWN, "Origin": "http://[x"}, 400, "malformed"),
    ],
)  # fmt: skip
def test_requests_are_judged(path: str, headers: dict[str, str], status: int, below: str) -> None:
    response = Guard(TOKEN).judge_request(path, headers)
    assert response.status == status
    assert response.path == below if status == 200 else below in response.text


def test_a_header_that_comes_twice_is_malformed() -> None:
    of = pytest.importorskip("websockets.datastructures", reason="see requirements-peers.txt")
    headers = of.Headers([("Host", "127.0.0.1:1"), ("Host", "evil.example")])
    assert Guard(TOKEN).judge_request(f"/{TOKEN}/", headers).status == 400


@pytest.mark.parametrize("packed", [False, True])
def test_the_title_is_ours_and_nothing_but_pages_is_unpacked(packed: bool) -> None:
    of = pytest.importorskip("websockets.datastructures", reason="see requirements-peers.txt")
    titles = b"<title>Viser</title>", b"<title>arm_emulator</title>"
    for kind, title in (("text/html", titles[1]), ("text/javascript", titles[0])):
        body = gzip.compress(titles[0]) if packed else titles[0]
        lines = {"Content-Type": kind, "Content-Length": str(len(body))}
        headers = of.Headers(lines | ({"Content-Encoding": "gzip"} if packed else {}))
        response = SimpleNamespace(headers=headers, body=body)
        _put_title(response)
        assert (gzip.decompress(response.body) if packed else response.body) == title
        assert headers["Content-Length"] == str(len(response.body))
        assert kind == "text/html" or response.body is body
    headers = of.Headers({"Content-Type": "image/png", "Content-Encoding": "gzip"})
    _put_title(SimpleNamespace(headers=headers, body=b"not packed at all"))


def test_any_request_has_an_answer() -> None:
    """Random bytes in path and headers end in one of three answers, and open nothing."""
    rng = np.random.default_rng(7)
    pieces = [
        "/",
        TOKEN,
        "..",
        "?",
        "%",
        "[",
        "]",
        "@",
        ":",
        "//",
        "\0",
        "\xff",
        "é",
        "#",
        " ",
        "x",
    ]
    for _ in range(2000):
        path, host, origin = (
            "".join(rng.choice(pieces, int(rng.integers(0, 6)))) for _ in range(3)
        )
        response = Guard(TOKEN).judge_request(path, {"Host": host, "Origin": origin})
        assert response.status in (400, 403), (path, host, origin)
        response = Guard(TOKEN).judge_request(path, OWN)
        assert response.status in (200, 400, 403), path
        assert (response.status == 200) <= (path.partition("?")[0].split("/")[1:2] == [TOKEN]), path


@pytest.mark.parametrize(("text", "host", "port"), [
    (0, "127.0.0.1", 0), ("8080", "127.0.0.1", 8080), ("0.0.0.0:80", "0.0.0.0", 80),
    ("[::1]:8080", "::1", 8080), ("arm.local:1", "arm.local", 1),
])  # fmt: skip
def test_an_address_is_a_port_with_an_optional_host(text: str | int, host: str, port: int) -> None:
    assert PageAddress.from_text(text) == PageAddress(host, port)


@pytest.mark.parametrize("text", ["", "host", "host:", "1:x", "70000", "-1", "127.0.0.1:70000"])
def test_foreign_addresses_are_refused(text: str) -> None:
    with pytest.raises(Refusal, match=r"must be \[HOST:\]PORT|port must be"):
        PageAddress.from_text(text)


def test_a_host_of_another_machine_and_a_taken_port_are_refused() -> None:
    with pytest.raises(Refusal, match="host must be of this machine"):
        PageAddress.from_text("192.0.2.1:0").choose_free_port()  # of documentation, RFC 5737
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(Refusal, match=f"port must be free, got {port}"):
            PageAddress.from_text(port).choose_free_port()


def test_a_page_for_foreign_machines_is_reached_by_addresses_and_by_its_own_name() -> None:
    every = PageAddress.from_text("0.0.0.0:0")
    assert all(map(every.is_requested_by, ("192.168.1.5", "fe80::1", "localhost", every.name)))
    assert not any(
        map(every.is_requested_by, ("evil.example", "192.168.1.5.evil.example", "", None))
    )
    page_address = PageAddress.from_text("192.168.1.5:0")
    assert page_address.is_requested_by("192.168.1.5") and not page_address.is_requested_by(
        "192.168.1.6"
    )
    assert (
        Guard(TOKEN, page_address).judge_request(f"/{TOKEN}/", {"Host": "192.168.1.5:80"}).status
        == 200
    )
    assert "token" in Guard(TOKEN, page_address).judge_request("/", {"Host": "192.168.1.5:80"}).text
