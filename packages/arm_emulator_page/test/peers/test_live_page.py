"""The page of a running network: what is done there stands in the bag, which re-drives it."""

import contextlib
import re
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from browser import PATIENCE, box, browser, fill, opened, press, shows, tick_of, without_token
from by_hand import events_of
from machines import own_three_axis

from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator_msgs.msg import MachineEvent

sync_api = pytest.importorskip("playwright.sync_api", reason="see requirements-peers.txt")
__all__ = ["browser"]  # a fixture
pytest.importorskip("viser", reason="see requirements-peers.txt")


OPEN = """external_wrench: true
varied: [joints.elbow.friction.viscous]
faults: [elbow.gear_breaks]"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """The three-axis arm with a number that can be set, and links that can be pushed."""
    return own_three_axis(tmp_path / "scene", OPEN)


def press_until(page: Any, button: str, text: str) -> None:
    """Press a button until an answer shows what was filled in: it is sent some moments later."""
    for _ in range(PATIENCE // 2000):
        press(page, button)
        with contextlib.suppress(sync_api.TimeoutError):
            page.get_by_text(text).first.wait_for(timeout=2000)
            return
    raise AssertionError(f"no answer {text!r}")


def paused_at(page: Any) -> int:
    """Return the tick at which the answer of the machine states that it is paused."""
    shows(page, "paused at tick")
    match = re.search(r"paused at tick (\d+)", page.inner_text("body"))
    assert match is not None
    page.wait_for_function(f"/tick {match[1]},/.test(document.body.innerText)")
    return int(match[1])


def url_of(log: Path) -> str:
    """Return the address that the emulator prints."""
    match = re.search(r"^page: (\S+)$", log.read_text() if log.exists() else "", re.MULTILINE)
    return match[1] if match else ""


def served(browser: Any, log: Path) -> str:
    """Return the address that the emulator prints, once it has."""
    waited = browser.new_page()  # gives a clock that lets playwright go on
    for _ in range(PATIENCE // 100):
        if url := url_of(log):
            break
        waited.wait_for_timeout(100)
    waited.close()
    return url


def pause_and_step(page: Any) -> int:
    """Pause the machine and let single ticks pass; return the tick at which it was paused."""
    press(page, "Pause")
    tick = paused_at(page)
    press(page, "+1")
    shows(page, f"tick {tick + 1},")
    page.locator("body").press("ArrowRight")
    shows(page, f"tick {tick + 2},")
    return tick


def change_the_machine(page: Any) -> None:
    """Do all that can be done to the machine."""
    page.get_by_role("tab", name="Machine").click()
    press(page, "off")
    shows(page, "power off: motors at 0 V")
    press(page, "on")
    shows(page, "power on")
    press(page, "save")
    shows(page, "here kept")
    fill(page, "Varied numbers", "0.75")
    shows(page, "joints.elbow.friction.viscous = 0.75")
    fill(page, "Varied numbers", "-1")
    shows(page, "must be")
    fill(page, "Faults (0: off)", "0.5")
    shows(page, "faults.elbow.gear_breaks = 0.5")
    fill(page, "Faults (0: off)", "0")
    shows(page, "faults.elbow.gear_breaks = 0 ")
    press(page, "restore")
    shows(page, "here restored")
    press(page, "Read")
    sync_api.expect(box(page, "Gain")).to_have_value(re.compile("joints"), timeout=PATIENCE)
    fill(page, "Value", "7.5")
    shows(page, "= 7.5")


def push_and_aim(page: Any) -> None:
    page.get_by_role("tab", name="Push").click()
    fill(page, "Force [N], world axes", "3", 2)
    press_until(page, "Push", "forearm is pushed with 0, 3, 0 N")
    page.get_by_role("tab", name="Target").click()
    press(page, "Copy the tool's pose")
    fill(page, "Position [m], world axes", "0.4", 1)
    press_until(page, "Send the tool there", "the tool is sent to 0.4")
    box(page, "Times real time").click()
    page.get_by_role("option", name="0.25", exact=True).click()
    shows(page, "0.25 times real time")


def go_to_a_breakpoint(page: Any, tick: int) -> int:
    """Let time go on, and the arm move, from a tick on; return where the machine is paused."""
    page.get_by_role("tab", name="Events").click()
    fill(page, "Stop when", "v.elbw > 1")
    press_until(page, "Set the breakpoint", "condition must name signals")
    fill(page, "Stop when", f"tick >= {tick + 700}")
    press_until(page, "Set the breakpoint", "stops where tick >=")
    press(page, "Play")
    shows(page, f"stopped: tick >= {tick + 700}")
    page.wait_for_function(f"/tick {tick + 700},/.test(document.body.innerText)")
    press(page, "Play")
    page.wait_for_function("/tool target \\d+ moving/.test(document.body.innerText)")
    press(page, "Pause")
    return paused_at(page)


def look_back(page: Any, tick: int) -> None:
    """Go to the moment of an event, by its button, and back to the present tick."""
    page.get_by_role("button", name="set varied").first.click()
    shows(page, "in the past")
    assert tick_of(page) < tick
    press(page, "Live")
    shows(page, f"tick {tick},")


def test_the_bag_repeats_all_that_is_done_on_the_page(
    browser: Any, scene: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, log = tmp_path / "bag", tmp_path / "log"
    streams = {"page_port": 0, "record": bag}
    with own_domain(), Bringup(str(scene), emulator=streams, log=log) as network:
        url = served(browser, log / "emulator.log")
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(without_token(url))
        page = opened(browser, url, play="Pause")
        tick = pause_and_step(page)
        change_the_machine(page)
        push_and_aim(page)
        tick = go_to_a_breakpoint(page, tick)
        look_back(page, tick)
        page.get_by_role("tab", name="Plot").click()
        page.locator(".uplot canvas").first.wait_for()
        page.screenshot(path=tmp_path / "live.png")
        page.context.close()
        assert network.stop_nodes()["emulator"] == 0
    assert check_bag(bag, scene=str(scene)) == 0
    assert "equal to the last bit" in capfd.readouterr().out
    kinds = [event.kind for event in events_of(bag)]
    assert kinds == [
        MachineEvent.KIND_POWER,
        MachineEvent.KIND_POWER,
        MachineEvent.KIND_SET_VARIED,
        MachineEvent.KIND_SET_VARIED,
        MachineEvent.KIND_SET_VARIED,
        MachineEvent.KIND_RESTORE,
        MachineEvent.KIND_EXTERNAL_WRENCH,
    ]
