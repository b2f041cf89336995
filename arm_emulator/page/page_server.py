"""The server of a page: guarded, and in our looks."""

from __future__ import annotations

import contextlib
import io
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.wheel import need_wheel
from arm_emulator.page.guard import Guard, guarded
from arm_emulator.page.page_address import PageAddress
from arm_emulator.page.page_token import page_token
from arm_emulator.page.style import dress


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
