"""The server of a page: guarded, in our looks, on this machine."""

from __future__ import annotations

import contextlib
import io
import socket
from typing import Any

from arm_emulator.base.count import check_count
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.wheel import need_wheel
from arm_emulator.page.guard import Guard, guarded
from arm_emulator.page.page_token import page_token
from arm_emulator.page.style import dress

LOCAL = "127.0.0.1"


class PageServer:
    """A server of viser for browsers on this machine.

    Attributes:
        server: of viser.
        url: address with the token, without which nothing is served.

    Args:
        port: TCP port; 0: any that is free.

    Raises:
        Refusal: viser is missing, or the port is taken.
    """

    def __init__(self, port: int = 0) -> None:
        need_wheel("the page", "viser", "viser")
        check_count("page", "port", port, 0, 65535)
        import viser

        token = page_token()
        # It prints addresses without the token, whatever it is asked.
        with guarded(Guard(token)), contextlib.redirect_stdout(io.StringIO()):
            try:
                self.server: Any = viser.ViserServer(LOCAL, _free(port), verbose=False)
            except (OSError, RuntimeError) as error:
                raise Refusal("page", "port", "be free", port) from error
        self.url = f"http://{LOCAL}:{self.server.get_port()}/?token={token}"
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


def _free(port: int) -> int:
    """Return the port, or one that is free now; the server would take another one in silence."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((LOCAL, port))
        return int(probe.getsockname()[1])
