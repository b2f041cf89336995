"""Hostile names on the page: its Markdown renders HTML, whose frames run JavaScript."""

from typing import Any

import pytest
from browser import PATIENCE, browser
from hostile_names import hostile_names

from arm_emulator.base.escape import escape_markdown
from arm_emulator_page.number_table import format_numbers
from arm_emulator_page.page_server import PageServer

__all__ = ["browser"]  # a fixture
pytest.importorskip("viser", reason="see requirements-peers.txt")
NAMES = hostile_names(200)
PIECE = 20  # names of one table
FRAME = "<iframe srcdoc='<script>parent.window.hacked=1</script>'></iframe>"


def test_nothing_of_a_name_runs_in_the_browser(browser: Any) -> None:
    """At the end a text that is not escaped does run: the browser would have run the others."""
    served = PageServer()
    try:
        gui = served.server.gui
        for k in range(0, len(NAMES), PIECE):
            names = NAMES[k : k + PIECE]
            for number, name in enumerate(names, k):
                gui.add_markdown(f"{escape_markdown(name)}")
                gui.add_markdown(f"Of {escape_markdown(name)} shown {number}.")
            gui.add_markdown(format_numbers(names, {"q": [0.0] * len(names)}))
        page = browser.new_context(viewport={"width": 640, "height": 480}).new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(served.url)
        for number, name in enumerate(NAMES):
            line = page.get_by_text(f"shown {number}.", exact=False).first
            line.wait_for(state="attached")
            words = "".join(c if c.isprintable() else "?" for c in " ".join(name.split()))
            text = " ".join(line.text_content().split())
            assert text == " ".join(f"Of {words} shown {number}.".split()), name
        assert page.evaluate("window.hacked") is None
        assert page.locator("iframe, svg[onload], img[onerror]").count() == 0
        gui.add_markdown(FRAME)
        page.wait_for_function("window.hacked === 1")
        page.context.close()
    finally:
        served.stop()
