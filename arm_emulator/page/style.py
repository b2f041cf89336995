"""Looks of the page, beside those of its library."""

from __future__ import annotations

from typing import Any

WIDTH = 600  # px: of the controls, with the numbers of the joints
# The library knows no table wider than its panel, and its panel on a phone is narrower than that.
# There the arm has the upper part of the screen, and the controls the lower one.
STYLE = """<style>
table { display: block; overflow-x: auto; white-space: nowrap; font-size: 12px !important; }
td, th { padding: 3px 5px !important; text-align: right; }
td:first-child { text-align: left; }
table.u-legend { white-space: normal; }  /* of a plot, an entry for each joint */
.mantine-Tabs-list { flex-wrap: wrap; }
@media (max-width: 36em) {
  div[style*="flex-grow: 1"][style*="height: 100%"] {
    flex: none !important; width: 100% !important; height: 42dvh !important; }
  .mantine-Paper-root[style*="position: fixed"][style*="bottom: 0"] {
    width: 100% !important; max-height: 58dvh !important; }
  .mantine-Paper-root[style*="position: fixed"] div[style*="width: 20em"] {
    width: 100% !important; }
  .mantine-Notifications-root { font-size: 10px; max-width: 70vw; }
}
</style>"""


def dress(server: Any) -> None:
    """Give a server of viser the looks of our pages."""
    gui = server.gui
    gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    gui.main_panel.dock_right()
    gui.main_panel.set_width(WIDTH)
    gui.add_html(STYLE)
