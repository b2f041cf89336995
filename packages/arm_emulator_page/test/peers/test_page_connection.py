"""Browsers that come late, and connections that break off."""

import contextlib
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from browser import browser, opened, press, shows, tick_of
from made_bags import synthetic

__all__ = ["browser"]  # a fixture
pytest.importorskip("viser", reason="see requirements-peers.txt")
LAST = 60


class Served:
    """A bag that the command `look` serves."""

    def __init__(self, bag: Path, port: int = 0) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "arm_emulator", "look", str(bag), "--port", str(port)],
            stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self.port = int(self.url.split(":")[2].partition("/")[0])

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


class Cable:
    """Passes connections on to a port until it is cut."""

    def __init__(self, to: int, port: int = 0) -> None:
        self._to, self._ends = to, list[socket.socket]()
        self._door = socket.create_server(("127.0.0.1", port))
        self.port = self._door.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        for end in (self._door, *self._ends):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                here, _ = self._door.accept()
                try:
                    there = socket.create_connection(("127.0.0.1", self._to))
                except OSError:  # nobody is there just now
                    here.close()
                    continue
                self._ends += here, there
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=self._pass, args=pair, daemon=True).start()

    @staticmethod
    def _pass(source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
            target.shutdown(socket.SHUT_RDWR)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic(tmp_path_factory.mktemp("bag") / "bag", [True] * LAST, runs=1)


def test_browsers_come_late_and_connections_and_servers_break_off(browser: Any, bag: Path) -> None:
    served = Served(bag)
    cable = Cable(served.port)
    try:
        browser_page = opened(browser, served.url)
        press(browser_page, "to end")
        shows(browser_page, f"tick {LAST},")
        far = opened(browser, served.url.replace(str(served.port), str(cable.port)))
        assert tick_of(far) == LAST, "who comes late sees the same moment"
        press(far, "-1")
        shows(browser_page, f"tick {LAST - 1},")
        # The cable is cut, and mended; meanwhile the page goes on.
        cable.cut()
        shows(far, "onnecting...")
        press(browser_page, "to start")
        shows(browser_page, "tick 0,")
        assert tick_of(far) == LAST - 1
        cable = Cable(served.port, cable.port)
        shows(far, "tick 0,")
        press(far, "+1")
        shows(browser_page, "tick 1,")
        # The server is killed, and started again at its port.
        url = served.url
        served.kill()
        shows(browser_page, "onnecting...")
        served = Served(bag, served.port)
        assert served.url != url, "a new run has a new token"
        for page, port in ((browser_page, served.port), (far, cable.port)):
            shows(page, "onnecting...")
            page.goto(served.url.replace(str(served.port), str(port)))
            shows(page, "tick 0,")
        press(browser_page, "to end")
        shows(far, f"tick {LAST},")
        browser_page.context.close()
        far.context.close()
    finally:
        cable.cut()
        served.kill()
