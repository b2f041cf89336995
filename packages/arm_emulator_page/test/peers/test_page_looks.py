"""The page on a phone, in dark and in light: nothing is cut off, and all can be read."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from browser import PHONE, browser, fits, opened, shows

from arm_emulator.analysis.torque_terms import TermsNow
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.runs.timeline import Timeline
from arm_emulator_page.run_page import RunPage
from arm_emulator_page.run_view import RunView
from arm_emulator_page.what_if import WhatIf

__all__ = ["browser"]  # a fixture
pytest.importorskip("viser", reason="see requirements-peers.txt")
READABLE = 4.5  # contrast of text, WCAG 2 level AA
COLORS = """() => {
  const of = (one, what) => getComputedStyle(one)[what].match(/[\\d.]+/g).slice(0, 3).map(Number);
  const text = [...document.querySelectorAll("p")].find(one => one.innerText.includes("tick"));
  let under = text;
  const clear = "rgba(0, 0, 0, 0)";
  while (getComputedStyle(under).backgroundColor === clear) under = under.parentElement;
  return [of(text, "color"), of(under, "backgroundColor")];
}"""


@pytest.fixture(scope="module")
def narrow_page() -> Iterator[RunPage]:
    line = Timeline(load_offline_run("ur5"), every=100)
    line.advance(100)
    page = RunPage(RunView.create_from_line(line, 100), lambda: (TermsNow({}, {}), []))
    WhatIf(page, line)
    yield page
    page.close()


def luminance(color: list[float]) -> float:
    """Relative luminance of sRGB from 0 to 255 (WCAG 2)."""
    c = np.array(color) / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_a_phone_shows_the_arm_above_all_controls(narrow_page: RunPage, browser: Any) -> None:
    page = opened(browser, narrow_page.url, viewport=PHONE, has_touch=True)
    canvas = max(
        (canvas.bounding_box() for canvas in page.locator("canvas").all()),
        key=lambda box: box["height"],
    )
    controls = page.get_by_role("button", name="Play", exact=True).bounding_box()
    assert canvas["width"] == PHONE["width"] and canvas["height"] > 0.4 * PHONE["height"]
    assert canvas["y"] + canvas["height"] <= controls["y"], "the controls do not hide the arm"

    for button in ("to start", "-1", "+1", "to end", "Play"):
        fits(page.get_by_role("button", name=button, exact=True))
    fits(page.locator("input[type=text]").first)  # of the slider
    last = {
        "Now": page.get_by_text("wrist_3_joint").first,
        "Plot": page.locator(".uplot canvas").first,
        "Events": page.get_by_role("button", name="Find the next"),
        "Torques": page.get_by_role("button", name="Explain this moment"),
        "What if": page.get_by_role("button", name="Go on from this moment"),
    }
    for tab, control in last.items():
        page.get_by_role("tab", name=tab).tap()
        control.wait_for()
        fits(control)
        for entry in page.locator(".u-legend .u-series:visible").all():
            box = entry.bounding_box()
            assert box["x"] + box["width"] <= PHONE["width"], "names of joints are cut off"
    page.get_by_role("button", name="to end", exact=True).tap()
    shows(page, "tick 100,")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    page.context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_is_dark_if_the_browser_prefers_it(
    narrow_page: RunPage, browser: Any, scheme: str
) -> None:
    page = opened(browser, narrow_page.url, color_scheme=scheme)
    text, under = map(luminance, page.evaluate(COLORS))
    assert (text > under) == (scheme == "dark")
    brighter, darker = max(text, under), min(text, under)
    assert (brighter + 0.05) / (darker + 0.05) >= READABLE
    page.context.close()
