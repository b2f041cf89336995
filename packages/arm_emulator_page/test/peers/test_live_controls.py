"""Controls of a running machine's page, pressed in a browser; those of ROS: test_live_page.py."""

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import psutil
import pytest
from browser import (
    PATIENCE,
    PHONE,
    box,
    browser,
    fill,
    fits,
    on_picture,
    opened,
    press,
    shows,
    tick_of,
)
from machines import own_three_axis

from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.record_row import RecordRow, list_columns
from arm_emulator.page.control_server import MachineControls
from arm_emulator_page import live_page
from arm_emulator_page.live_page import LivePage

sync_api = pytest.importorskip("playwright.sync_api", reason="see requirements-peers.txt")
__all__ = ["browser"]  # a fixture
pytest.importorskip("viser", reason="see requirements-peers.txt")
# A browser's first message: without a camera the page sends it nothing but the first picture.
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (1.0, -1.0, 1.0),
    "fov": 1.3, "near": 0.01, "far": 100.0, "image_height": 480, "image_width": 640,
    "look_at": (0.0, 0.0, 0.3), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip
VISCOUS = "joints.elbow.friction.viscous"
BREAKS = "faults.elbow.gear_breaks"
OPEN = f"""external_wrench: true
varied: [{VISCOUS}]
faults: [elbow.gear_breaks]"""


class Live:
    """A page of a machine that this test advances itself."""

    def __init__(self, scene: Path) -> None:
        self.plant = plant = Plant(str(scene))
        self.hands = MachineControls(plant, steps=True)
        self._row = RecordRow(plant)
        kind, columns = self._row.rows.dtype, list_columns(plant.scene)
        self.page = LivePage(plant.scene, columns, kind, self.hands, 0, dict(plant.parameters))
        self.url = self.page.url
        self.take()

    def take(self, dropped: int = 0) -> None:
        """Show the machine as it is."""
        self.page.take_rows(self._row.take_row(), dropped)

    def advance(self, ticks: int) -> None:
        for _ in range(ticks):
            self.plant.exchange(np.array([1.0, 0.0, 2.0]))
            self.take()

    def until(self, page: Any, holds: Any) -> None:
        """Draw, and advance as the page asks, until something holds."""
        for _ in range(PATIENCE // 100):
            self.page.draw_rows()
            self.advance(self.hands.due)
            self.hands.due = 0
            if holds():
                return
            page.wait_for_timeout(100)
        raise AssertionError("it does not come to hold")

    def shows(self, page: Any, text: str) -> None:
        self.until(page, lambda: text in page.inner_text("body"))


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return own_three_axis(tmp_path_factory.mktemp("scene") / "own", OPEN)


@pytest.fixture
def live(scene: Path) -> Iterator[Live]:
    served = Live(scene)
    yield served
    served.page.close()


def test_keys_steps_and_the_past(live: Live, browser: Any) -> None:
    live.advance(300)
    page = opened(browser, live.url, play="Pause")
    live.shows(page, "tick 300,")
    page.locator("body").press("Space")
    live.until(page, lambda: live.hands.paused)
    live.shows(page, "paused")
    for key, tick in (("ArrowRight", 301), ("ArrowUp", 311)):
        page.locator("body").press(key)
        live.shows(page, f"tick {tick},")
    for button, tick in (("+1", 312), ("+10", 322), ("+100", 422)):
        press(page, button)
        live.shows(page, f"tick {tick},")
    slider = page.locator("input[type=text]").first
    slider.fill("120")
    slider.press("Enter")
    live.shows(page, "in the past")
    assert tick_of(page) == 120
    second_page = opened(browser, live.url, play="Play")
    live.until(second_page, lambda: tick_of(second_page) == 120)  # all browsers see the same moment
    press(second_page, "Live")
    live.shows(page, "tick 422,")
    second_page.context.close()
    page.get_by_role("tab", name="Plot").click()
    for span in ("1 s", "10 s", "60 s", "the whole run"):
        box(page, "Span").click()
        page.get_by_role("option", name=span, exact=True).click()
        seconds = min(0.422, float(span.split()[0])) if span[0].isdigit() else 0.422
        live.until(
            page, lambda s=seconds: len(t := live.page.plotted[0]) and t[-1] - t[0] > s - 0.01
        )
    box(page, "Signal").click()
    page.get_by_role("option", name="current", exact=True).click()
    live.until(page, lambda: live.page.plotted[3][-1] == live.plant.state.current[2])
    page.evaluate("document.activeElement.blur()")  # keys in a field are its own
    page.locator("body").press("Space")
    live.until(page, lambda: not live.hands.paused)
    page.context.close()


def test_power_numbers_and_faults(live: Live, browser: Any) -> None:
    page = opened(browser, live.url, play="Pause")
    page.get_by_role("tab", name="Machine").click()
    press(page, "off")
    live.until(page, lambda: not live.plant.powered)
    press(page, "on")
    live.until(page, lambda: live.plant.powered)
    fill(page, "Varied numbers", "0.75")
    live.until(page, lambda: live.plant.parameters[VISCOUS] == 0.75)
    fill(page, "Faults (0: off)", "1")
    live.until(page, lambda: live.plant.parameters[BREAKS] == 1.0)
    fill(page, "Faults (0: off)", "2")
    live.shows(page, "must be")
    assert live.plant.parameters[BREAKS] == 1.0
    page.get_by_role("tab", name="Events").click()
    live.shows(page, "refused:")  # in the list, too
    page.context.close()


def test_a_handle_that_is_dragged_pulls_at_its_link(live: Live, browser: Any) -> None:
    page = opened(browser, live.url, play="Pause", viewport={"width": 1000, "height": 620})
    page.locator(".mantine-Notification-closeButton").first.click()
    page.get_by_role("tab", name="Push").click()
    box(page, "Drag a handle in the picture").check()
    fill(page, "Drag a handle in the picture", "200", 2)
    live.until(page, lambda: live.page.server.scene.get_handle_by_name("/push") is not None)
    link = live.page.arm.locate_link("forearm")

    def force() -> Any:
        return np.array(live.plant.external_wrenches["forearm"].force)

    def dragged() -> bool:
        """Drag the handle up; before it is drawn, this turns the camera."""
        begin, end = (
            np.array(on_picture(page, live.page, link + np.array([0.0, 0.0, z])))
            for z in (0.15, 0.3)
        )
        page.mouse.move(*begin)
        page.mouse.down()
        for share in np.linspace(0.0, 1.0, 6)[1:]:
            page.mouse.move(*(begin + share * (end - begin)))
            page.wait_for_timeout(200)  # as fast as a hand
        page.mouse.up()
        return bool(force()[2] > 20.0)

    live.until(page, dragged)
    handle = live.page.server.scene.get_handle_by_name("/push")
    live.until(
        page, lambda: np.allclose(force(), 200.0 * (np.array(handle.position) - link), atol=1e-9)
    )
    assert abs(force()[:2]).max() < 1e-9, "along the arrow that was dragged"
    assert live.plant.external_wrenches["forearm"].axes == "world"
    press(page, "Let go")
    live.until(page, lambda: not force().any())
    # By numbers, at another link.
    box(page, "Link").click()
    page.get_by_role("option", name="upper_arm", exact=True).click()
    fill(page, "Moment [N m], world axes", "1.5", 3)

    def pushed() -> bool:
        press(page, "Push")  # again: a field's number may arrive after the press
        return live.plant.external_wrenches["upper_arm"].moment == (0.0, 0.0, 1.5)

    live.until(page, pushed)
    page.context.close()


def test_rows_without_room_are_counted_on_the_page(live: Live, browser: Any) -> None:
    page = opened(browser, live.url, play="Pause")
    live.take(dropped=17)
    live.shows(page, "17 ticks not shown")
    page.context.close()


def test_a_phone_shows_all_controls_of_a_running_machine(live: Live, browser: Any) -> None:
    page = opened(browser, live.url, play="Pause", viewport=PHONE, has_touch=True)
    live.shows(page, "tick 0,")
    last = {
        "Now": page.locator("td").first,
        "Plot": page.locator(".uplot canvas").first,
        "Push": page.get_by_role("button", name="Let go"),
        "Machine": box(page, "Varied numbers"),
        "Events": page.get_by_text("No event yet").first,
    }
    for button in ("Pause", "+1", "+100"):
        fits(page.get_by_role("button", name=button, exact=True))
    for tab, control in last.items():
        page.get_by_role("tab", name=tab).tap()
        control.wait_for()
        fits(control)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    shows(page, "three_axis")
    page.context.close()


@contextlib.contextmanager
def client(url: str) -> Iterator[Any]:
    """Connect as a browser does, by hand."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocols = [Subprotocol(f"viser-v{viser.__version__}")]
    address, how = url.replace("http:", "ws:"), {"max_size": None, "ping_interval": None}
    with connect(address, subprotocols=protocols, **how) as connection:
        connection.send(
            msgspec.msgpack.encode(CAMERA)
        )  # without one a page sends its first picture alone
        yield connection


def test_a_browser_that_stops_reading_blocks_no_process_and_costs_no_memory(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other one gets every picture, and nothing is kept for the first."""
    monkeypatch.setattr(live_page, "PLOTTED", 0.0)  # a plot in every picture
    live.advance(1500)
    received = 0

    def read(socket: Any) -> None:
        nonlocal received
        for message in socket:
            received += len(message)

    process, max_bytes, enough = psutil.Process(), 4e6, 12e6  # B
    with client(live.url) as stalled, client(live.url) as reads:
        reader = threading.Thread(target=read, args=[reads])
        reader.start()
        begin, growth, deadline = 0, 0, time.monotonic() + PATIENCE / 1e3
        while received - begin < enough:
            assert time.monotonic() < deadline, f"{received} bytes came"
            live.advance(1)
            live.page.draw_rows()
            time.sleep(0.005)  # lets the server's thread work
            if not begin and received > max_bytes:  # what any browser costs is there
                begin, before = received, process.memory_info().rss
            elif begin:
                growth = max(growth, process.memory_info().rss - before)
        assert live.page.browsers == 2 and stalled.state.name == "OPEN"
        reads.close()
        reader.join()
    assert growth < 0.5 * enough, "one that keeps what was not read keeps all of it [B]"
