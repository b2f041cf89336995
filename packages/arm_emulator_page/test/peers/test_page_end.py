"""The end of a page beside clients that do not answer, and clients that go before they ask."""

import contextlib
import logging
import socket
import struct
import time
from urllib.parse import urlsplit

import pytest

from arm_emulator_page.live_process import GRACE
from arm_emulator_page.page_server import PageServer

viser = pytest.importorskip("viser", reason="see requirements-peers.txt")
PATIENCE = 60.0  # s, wall


def connect(served: PageServer, request: str) -> socket.socket:
    """Return a connection that has sent a request, of which PATH and HOST are filled in."""
    at = urlsplit(served.url)
    client = socket.create_connection((at.hostname, at.port), timeout=PATIENCE)
    client.sendall(request.replace("PATH", at.path).replace("HOST", at.netloc).encode())
    return client


UPGRADE = (
    "GET PATH HTTP/1.1\r\nHost: HOST\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
    f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
)
PAGE = "GET PATH?look=dark HTTP/1.1\r\nHost: HOST\r\n\r\n"


@pytest.mark.parametrize(
    ("request_text", "answer"),
    [(UPGRADE, b"HTTP/1.1 101"), ("GET PATH HTT", b""), ("", b""), (PAGE, b"HTTP/1.1 200")],
    ids=["asleep", "in its request", "before it", "does not read"],
)
def test_a_page_ends_beside_a_client_that_does_not_answer(
    request_text: str, answer: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    served = PageServer()
    with contextlib.ExitStack() as opened:
        for _ in range(3):
            client = opened.enter_context(connect(served, request_text))
            assert not answer or client.recv(len(answer)) == answer
        # Answered after them: the server has met them.
        opened.enter_context(connect(served, PAGE)).recv(1)
        began = time.monotonic()
        served.stop()
        assert time.monotonic() - began < GRACE  # viser alone takes 6 s
    assert not caplog.records, caplog.text


def test_clients_that_go_before_they_ask_leave_no_traceback(
    caplog: pytest.LogCaptureFixture,
) -> None:
    served = PageServer()
    with caplog.at_level(logging.INFO, "websockets.server"):
        for text in ("", "GET PATH HTT", "\x16\x03\x01\r\n\r\n"):
            with connect(served, text) as client:
                reset = struct.pack("ii", 1, 0)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
        with connect(served, PAGE) as client:
            assert client.recv(12) == b"HTTP/1.1 200"
        served.stop()
    assert not any(record.exc_info for record in caplog.records), caplog.text
