"""Commands with `--page` serve their page: to the token alone, its buttons work, Ctrl-C ends it."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import browser, opened, press, shows, tick_of, until, without_token

__all__ = ["browser"]  # a fixture
pytest.importorskip("viser", reason="see requirements-peers.txt")
PATIENCE = 180.0  # s, wall


ROOT = Path(__file__).resolve().parents[3]
LINE = f"page{os.getpid() % 10000}a", f"page{os.getpid() % 10000}b"
READ_ONLY = "This machine can only be watched."


def pressed(page: Any) -> None:
    """Pause and power, as every door with a clock has them."""
    press(page, "Pause")
    page.get_by_role("button", name="Play", exact=True).wait_for()
    press(page, "Play")
    page.get_by_role("tab", name="Machine").click()
    press(page, "off")
    shows(page, "power off")
    page.get_by_role("tab", name="Events").click()
    page.get_by_role("button", name="power off").wait_for()


def looked_at(page: Any) -> None:
    """A run of a campaign: at its end, and without controls."""
    page.get_by_role("tab", name="Machine").click()
    shows(page, READ_ONLY)
    page.wait_for_function("/tick [1-9]/.test(document.body.innerText)")


def stepped(page: Any) -> None:
    """The page of a run without a network."""
    press(page, "to end")
    shows(page, "tick 100,")


def steps_between(page: Any) -> None:
    """Firmware stands with its machine, goes on by single ticks, and freely."""
    press(page, "Pause")
    page.get_by_role("button", name="Play", exact=True).wait_for()
    # An event has the tick at which the machine stands; the page may still show one before it.
    page.get_by_role("tab", name="Machine").click()
    press(page, "on")
    page.get_by_role("tab", name="Events").click()
    event = page.get_by_role("button", name=": power on")
    event.wait_for()
    paused_tick = int(event.inner_text().partition(":")[0])
    press(page, "+10")
    shows(page, f"tick {paused_tick + 10},")
    press(page, "Play")
    until(page, lambda: tick_of(page) > paused_tick + 10)
    pressed(page)


def write_firmware(folder: Path) -> None:
    """Build firmware that turns an axis on, and sleeps."""
    from cortex_m import tiny, write_board  # skips where there is no cross compiler

    tiny(
        folder,
        """
int main(void) {
  SYSTICK_LOAD = 168000 - 1, SYSTICK_CTRL = 7;
  for (;;) sleep();
}
void SysTick_Handler(void) { REGISTER(0x40000100) = 0x3f800000; /* 1 V */ }
""",
    )
    write_board(folder)


@pytest.mark.parametrize(("words", "label", "press"), [
    (["canopen", "three_axis"], "Pause", pressed),
    (["modbus", "three_axis", "--link", "arm"], "Pause", pressed),
    (["udp", "three_axis", "--listen", "0"], "Pause", pressed),
    (["ethercat", "three_axis", "--interface", LINE[0]], "Pause", pressed),
    (["firmware", "board.yaml", "tiny.elf", "--seconds", "3600"], "Pause", steps_between),
    (["campaign", str(ROOT / "examples/campaign.yaml"), "--replay", "0"], "Live", looked_at),
    (["run", "three_axis", "--seconds", "0.1"], "Play", stepped),
], ids=lambda case: case[0] if isinstance(case, list) else "")  # fmt: skip
def test_its_page_is_served_to_the_token(
    words: list[str], label: str, press: Callable[[Any], None], tmp_path: Path, browser: Any
) -> None:
    with contextlib.ExitStack() as open_:
        if words[0] == "ethercat":
            open_.enter_context(line())
        if words[0] == "firmware":
            write_firmware(tmp_path)
        serve(words, label, press, tmp_path, browser)


@contextlib.contextmanager
def line() -> Iterator[None]:
    """A line of Ethernet without a master."""
    command = ["ip", "link", "add", LINE[0], "type", "veth", "peer", "name", LINE[1]]
    if os.getuid() != 0 or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("a line of Ethernet needs root and iproute2")
    try:
        yield
    finally:
        subprocess.run(["ip", "link", "delete", LINE[0]], check=True)


def serve(
    words: list[str], label: str, press: Callable[[Any], None], folder: Path, browser: Any
) -> None:
    """Run a command with a page, and press its buttons."""
    command = [sys.executable, "-u", "-m", "arm_emulator", *words, "--page", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder) as door:
        late = threading.Timer(PATIENCE, door.kill)
        late.start()
        assert door.stdout is not None
        matches = (re.match(r"(?:page: )?(http\S+)$", line) for line in door.stdout)
        url = next(match[1] for match in matches if match)
        with urllib.request.urlopen(url) as answer:
            assert answer.status == 200
        plain = without_token(url)
        others = ({"Host": "evil.example"}, {"Origin": "http://evil.example"})
        for request in (plain, *(urllib.request.Request(url, headers=each) for each in others)):
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(request)
        with pytest.raises(urllib.error.URLError, match="refused"):  # another address of this host
            urllib.request.urlopen(url.replace("127.0.0.1", "127.0.0.2"))
        page = opened(browser, url, play=label)
        press(page)
        page.context.close()
        door.send_signal(signal.SIGINT)
        door.stdout.read()
        late.cancel()
    ends = -signal.SIGINT if words[0] == "firmware" else 0  # that one has nothing to close
    assert door.returncode == ends
