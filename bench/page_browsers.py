"""Browsers that take all that a page sends: one that draws nothing, and Chromium."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from arm_emulator.base.process import below
from bench.page_picture import in_chromium

PATIENCE = 120.0  # s, wall
IDLE = 19  # niceness of Chromium, whose drawing is the work of a graphics card elsewhere
# A browser's first message: without a camera the page sends it nothing but the first picture.
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (1.0, -1.0, 1.0),
    "fov": 1.3, "near": 0.01, "far": 100.0, "image_height": 480, "image_width": 640,
    "look_at": (0.0, 0.0, 0.3), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip
DRAWN = """() => {
  window.drawn = 0;
  const count = () => { window.drawn += 1; requestAnimationFrame(count); };
  requestAnimationFrame(count);
}"""

Drawn = Callable[[], int]  # pictures drawn so far


@contextmanager
def taking(url: str) -> Iterator[Drawn]:
    """Take all that a page sends in this block, and draw nothing."""
    import msgspec
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocols = [Subprotocol(f"viser-v{viser.__version__}")]
    with connect(url.replace("http:", "ws:"), max_size=None, subprotocols=protocols) as socket:
        socket.send(msgspec.msgpack.encode(CAMERA))
        thread = threading.Thread(target=lambda: [None for _ in socket])
        thread.start()
        yield lambda: 0
        socket.close()
        thread.join()


@contextmanager
def drawing(url: str) -> Iterator[Drawn]:
    """Draw a page in Chromium in this block, without a graphics card."""
    drawn, ready, done = [0], threading.Event(), threading.Event()

    def draw() -> None:
        with in_chromium(url) as page:
            page.get_by_text("Pause", exact=True).first.wait_for()
            page.get_by_role("tab", name="Plot").click()
            page.locator(".uplot canvas").first.wait_for()
            page.evaluate(DRAWN)
            ready.set()
            while not done.is_set():
                page.wait_for_timeout(200)
                drawn[0] = page.evaluate("window.drawn")

    thread = threading.Thread(target=draw)
    thread.start()
    try:
        if not ready.wait(PATIENCE):
            raise TimeoutError("Chromium shows no page")
        for process in browsers():
            with contextlib.suppress(ProcessLookupError):
                os.setpriority(os.PRIO_PROCESS, process, IDLE)
        yield lambda: drawn[0]
    finally:
        done.set()
        thread.join()


def browsers() -> list[int]:
    """Return the processes of Chromium below this one."""
    return [one for one in below(os.getpid()) if b"--type=" in _command(one)]


def sent(url: str) -> int:
    """Return the bytes that a page has sent on connections that are open now (by `ss`)."""
    words = ["ss", "-tinH", "sport", "=", f":{urlsplit(url).port}"]
    listed: Any = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    return sum(map(int, re.findall(r"bytes_sent:(\d+)", listed)))


def resident(process: int) -> float:
    """Return the memory of a process [MB]; 0: it has ended."""
    with contextlib.suppress(OSError):
        status = Path(f"/proc/{process}/status").read_text()
        return int((re.findall(r"VmRSS:\s+(\d+)", status) or [0])[0]) / 1e3
    return 0.0


def page_process(emulator: int) -> int:
    """Return the process of the page that an emulator has started."""
    return next(one for one in below(emulator) if b"live_process" in _command(one))


def _command(process: int) -> bytes:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/cmdline").read_bytes()
    return b""
