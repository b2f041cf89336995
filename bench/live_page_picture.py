"""Picture of the page of a running network: three_axis, with a handle that pulls at its forearm.

It needs requirements-peers.txt and Chromium.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import yaml

from arm_emulator.base.config_files import find_scene
from arm_emulator.ros.bringup import Bringup
from arm_emulator.ros.ros_domain import own_domain
from bench.live_page import url_of
from bench.page_picture import in_chromium

SIZE: Any = {"width": 1000, "height": 620}
DRAG = "xpath=//*[text()='Drag a handle in the picture']/following::input[1]"


def picture(folder: Path) -> Path:
    """Draw the page into a folder, and return the picture's path.

    Raises:
        Refusal: Chromium is missing.
    """
    scene, log = pushed_scene(folder), folder / "log"
    file = folder / "live_page.png"
    emulator = {"page_port": 0, "real_time_factor": 1.0}
    network = Bringup(str(scene), start="first_answer", emulator=emulator, log=log)
    with own_domain(), network, in_chromium(url_of(log / "emulator.log"), SIZE) as shown:
        shown.wait_for_function("/tick [1-9]/.test(document.body.innerText)")
        shown.get_by_role("tab", name="Push").click()
        shown.locator(DRAG).check()
        shown.get_by_role("button", name="Pause", exact=True).click()
        shown.get_by_text("s, paused").first.wait_for()
        shown.screenshot(path=file)
    return file


def pushed_scene(folder: Path) -> Path:
    """Write the three-axis arm, its links open to pushes, into a folder, and return its file."""
    given = find_scene("three_axis")
    data = yaml.safe_load(given.read_text(encoding="utf-8"))
    data["urdf"] = str((given.parent / data["urdf"]).resolve())
    data["external_wrench"] = True
    for kind in ("servo", "motion"):
        (folder / kind).mkdir()
        shutil.copy(given.parent / kind / "three_axis.yaml", folder / kind)
    file = folder / "three_axis.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return file
