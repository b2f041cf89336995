"""The server of a page: guarded, and in our looks."""

from __future__ import annotations

import contextlib
import io
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.wheel import need_wheel
from arm_emulator.page.guard import Guard, guarded
from arm_emulator.page.page_address import PageAddress, page_token


class PageServer:
    """A server of viser.

    Attributes:
        server: of viser.
        url: address with the token, without which nothing is served.

    Args:
        at: [HOST:]PORT, see `PageAddress`; 0: browsers on this machine, any port that is free.

    Raises:
        Refusal: viser is missing, no such address, or the port is taken.
    """

    def __init__(self, at: str | int = 0) -> None:
        need_wheel("the page", "viser", "viser")
        address = PageAddress.of(at).free()
        import viser

        token = page_token()
        # It prints addresses without the token, whatever it is asked.
        with guarded(Guard(token, address)), contextlib.redirect_stdout(io.StringIO()):
            try:
                self.server: Any = viser.ViserServer(address.host, address.port, verbose=False)
            except (OSError, RuntimeError) as error:
                raise Refusal("page", "port", "be free", address.port) from error
        self.url = address.url(token)
        dress(self.server)
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/floor", 4.0, 4.0, cell_size=0.25)

    def look_from(self, size: float) -> None:
        """Let browsers that come look at an arm of a size [m]."""
        camera = self.server.initial_camera
        camera.position = (size, -size, 0.8 * size)
        camera.look_at = (0.0, 0.0, 0.3 * size)

    def stop(self) -> None:
        """End the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


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
