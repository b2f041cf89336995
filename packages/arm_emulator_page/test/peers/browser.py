"""The browser in which tests look at a page."""

import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

PHONE: Any = {"width": 390, "height": 844}  # px
PATIENCE = 60_000  # ms: software rendering on a busy machine
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
# WebGL without a GPU.
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextmanager
def chromium() -> Iterator[Any]:
    """Run Chromium without a window."""
    api = pytest.importorskip("playwright.sync_api", reason="see requirements-peers.txt")
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed")
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as chromium_browser:
        yield chromium_browser


def without_token(url: str) -> str:
    """Return the address of a page without the folder that is its token."""
    return url.removesuffix("/").rpartition("/")[0] + "/"


def opened(browser: Any, url: str, play: str = "Play", **how: Any) -> Any:
    """Open a page in a session of its own, and wait for its controls."""
    page = browser.new_context(**{"viewport": {"width": 640, "height": 480}, **how}).new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(url)
    page.get_by_text(play, exact=True).first.wait_for()
    return page


def fits(element: Any) -> None:
    """Check that a control is within the screen of a phone, once it is scrolled to."""
    element.scroll_into_view_if_needed()
    box = element.bounding_box()
    for begin, size in (("x", "width"), ("y", "height")):
        assert 0 <= box[begin] and box[begin] + box[size] < PHONE[size] + 1, (element, box)


def on_picture(page: Any, served: Any, p_W: Any) -> tuple[float, float]:
    """Return where a point of the world (3,) [m] is on the screen [px]."""
    from viser.transforms import SO3

    (client,) = served.server.get_clients().values()
    camera = client.camera
    canvas = max(
        (canvas.bounding_box() for canvas in page.locator("canvas").all()),
        key=lambda box: box["height"],
    )
    x, y, z = SO3(camera.wxyz).as_matrix().T @ (np.asarray(p_W) - camera.position)
    scale = 0.5 * canvas["height"] / np.tan(0.5 * camera.fov)
    right, down = canvas["x"] + 0.5 * canvas["width"], canvas["y"] + 0.5 * canvas["height"]
    return float(right + scale * x / z), float(down + scale * y / z)


def tick_of(page: Any) -> int:
    """Return the tick that a page shows."""
    match = re.search(r"tick (\d+),", page.inner_text("body"))
    assert match is not None
    return int(match[1])


def shows(page: Any, text: str) -> None:
    """Wait until a page shows a text."""
    page.get_by_text(text).first.wait_for()


def until(page: Any, holds: Callable[[], bool]) -> None:
    """Wait until something of the page's server holds: a control's value arrives after its key."""
    deadline = time.monotonic() + PATIENCE / 1e3
    while not holds():
        assert time.monotonic() < deadline, "it does not come to hold"
        page.wait_for_timeout(20)  # lets playwright work


def press(page: Any, button: str) -> None:
    page.get_by_role("button", name=button, exact=True).click()


def box(page: Any, label: str, place: int = 1) -> Any:
    """Return a field behind a label, by its place among them."""
    return page.locator(f"xpath=//*[text()='{label}']/following::input[{place}]")


def fill(page: Any, label: str, value: str, place: int = 1) -> None:
    text_box = box(page, label, place)
    text_box.fill(value)
    text_box.press("Enter")


def choose(page: Any, label: str, option: str) -> None:
    box(page, label).click()
    page.get_by_role("option", name=option, exact=True).click()


def go_to(page: Any, tick: int) -> None:
    """Write a tick into the slider's field."""
    slider = page.locator("input[type=text]").first
    slider.fill(str(tick))
    slider.press("Enter")
