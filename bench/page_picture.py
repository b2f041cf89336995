"""Picture of the page in a browser: ur5 in the middle of a move.

It needs requirements-peers.txt and Chromium.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Refusal, Timeline
from arm_emulator.analysis.torque_terms import TermsNow
from arm_emulator.page.run_page import RunPage
from arm_emulator.page.subject import Subject
from arm_emulator.runs.offline import load_offline_run
from bench.rewind import new_target

SIZE: Any = {"width": 1280, "height": 720}
LAST, AT = 2500, 1080  # ticks
PATIENCE = 200_000  # ms, of software rendering
# WebGL without a GPU.
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@contextmanager
def in_chromium(url: str, size: Any = SIZE) -> Iterator[Any]:
    """Open a page in Chromium without a window, of a size, in this block.

    Raises:
        Refusal: Chromium is missing.
    """
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        raise Refusal("page", "Chromium", "be installed", "none")
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, headless=True, args=FLAGS)
        shown = browser.new_page(viewport=size)
        shown.set_default_timeout(PATIENCE)
        shown.goto(url)
        # The browser's remark on software rendering.
        shown.locator(".mantine-Notification-closeButton").first.click()
        shown.locator(".mantine-Notification-closeButton").first.wait_for(state="detached")
        yield shown
        browser.close()


def picture(folder: Path) -> Path:
    """Draw the page into a folder, and return the picture's path.

    Raises:
        Refusal: Chromium is missing.
    """
    line = Timeline(load_offline_run("ur5"))
    line.advance(200)
    line.change("target", partial(new_target, offset=np.array([-0.1, 0.35, 0.15])))
    line.advance(LAST - line.tick)
    line.go_to(AT)
    page = RunPage(Subject.of(line, LAST), lambda: (TermsNow({}, {}), []))
    file = folder / "look.png"
    try:
        with in_chromium(page.url) as shown:
            shown.get_by_role("tab", name="Plot").click()
            shown.locator(".uplot canvas").first.wait_for()
            shown.screenshot(path=file)
    finally:
        page.close()
    return file
