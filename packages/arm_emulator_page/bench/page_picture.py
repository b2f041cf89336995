"""Pictures of the page in a browser: ur5 in the middle of a move, and a running network.

They need requirements-peers.txt and Chromium.
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator import OfflineRun, Pose, Refusal, Timeline
from arm_emulator.analysis.torque_terms import TermsNow
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_page.run_page import RunPage
from arm_emulator_page.run_view import RunView

LOOK: Any = {"width": 1280, "height": 720}
LIVE: Any = {"width": 1000, "height": 620}
LAST, AT = 2500, 1080  # ticks
PATIENCE = 200  # s, wall, of software rendering
# WebGL without a GPU.
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
DRAG = "xpath=//*[text()='Drag a handle in the picture']/following::input[1]"


@contextmanager
def _open_chromium(url: str, size: Any) -> Iterator[Any]:
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
        page = browser.new_page(viewport=size)
        page.set_default_timeout(1000 * PATIENCE)
        page.goto(url)
        # The browser's remark on software rendering.
        page.locator(".mantine-Notification-closeButton").first.click()
        page.locator(".mantine-Notification-closeButton").first.wait_for(state="detached")
        yield page
        browser.close()


def send_target(run: OfflineRun, offset: Array) -> None:
    """Send the tool to a place beside the start (3,) [m]."""
    R_WT, p_WT = run.controller.kinematics.forward(run.session.scene.start)
    run.instructor.add(run.session.logical_ns, Pose(p_WT + offset, R_WT))


def draw_run_page(folder: Path) -> Path:
    """Draw the page of a run of ur5 into a folder, and return the picture's path.

    Raises:
        Refusal: Chromium is missing.
    """
    line = Timeline(load_offline_run("ur5"))
    line.advance(200)
    line.change("target", partial(send_target, offset=np.array([-0.1, 0.35, 0.15])))
    line.advance(LAST - line.tick)
    line.go_to(AT)
    page = RunPage(RunView.create_from_line(line, LAST), lambda: (TermsNow({}, {}), []))
    file = folder / "look.png"
    try:
        with _open_chromium(page.url, LOOK) as browser_page:
            browser_page.get_by_role("tab", name="Plot").click()
            browser_page.locator(".uplot canvas").first.wait_for()
            browser_page.screenshot(path=file)
    finally:
        page.close()
    return file


def draw_live_page(folder: Path) -> Path:
    """Draw the page of a network of three_axis, with a handle that pulls at its forearm.

    Raises:
        Refusal: Chromium is missing.
    """
    scene, log, file = _write_pushed_scene(folder), folder / "log", folder / "live_page.png"
    emulator = {"page_port": 0, "real_time_factor": 1.0}
    network = Bringup(str(scene), start="first_answer", emulator=emulator, log=log)
    with (
        own_domain(),
        network,
        _open_chromium(_find_url(log / "emulator.log"), LIVE) as browser_page,
    ):
        browser_page.wait_for_function("/tick [1-9]/.test(document.body.innerText)")
        browser_page.get_by_role("tab", name="Push").click()
        browser_page.locator(DRAG).check()
        browser_page.get_by_role("button", name="Pause", exact=True).click()
        browser_page.get_by_text("s, paused").first.wait_for()
        browser_page.screenshot(path=file)
    return file


def _find_url(log: Path) -> str:
    """Return the address that the emulator prints into its log."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        match = re.search(r"^page: (\S+)$", log.read_text() if log.exists() else "", re.MULTILINE)
        if match:
            return match[1]
        time.sleep(0.1)
    raise TimeoutError("the emulator prints no address")


def _write_pushed_scene(folder: Path) -> Path:
    """Write the three-axis arm, its links open to pushes, into a folder, and return its file."""
    scene_file = find_scene("three_axis")
    data = yaml.safe_load(scene_file.read_text(encoding="utf-8"))
    data["urdf"] = str((scene_file.parent / data["urdf"]).resolve())
    data["external_wrench"] = True
    for kind in ("servo", "motion"):
        (folder / kind).mkdir()
        shutil.copy(scene_file.parent / kind / "three_axis.yaml", folder / kind)
    file = folder / "three_axis.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return file
