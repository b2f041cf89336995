"""The machine behind a TCP socket: lines of JSON, see `json_lines`."""

from __future__ import annotations

import socket

from arm_emulator.base.address import not_free
from arm_emulator.doors.json_lines import JsonLinesServer
from arm_emulator.machine.session import Session

PORT = 50780


class TcpServer(JsonLinesServer):
    """Answers clients that connect by TCP.

    Attributes:
        address: host and port where it listens.

    Args:
        session: the machine.
        host: of the interface that it listens on.
        port: 0: any that is free.

    Raises:
        Refusal: it cannot listen there.
    """

    def __init__(self, session: Session, host: str = "127.0.0.1", port: int = PORT) -> None:
        try:
            listening = socket.create_server((host, port), backlog=1)
        except (OSError, OverflowError) as error:
            raise not_free("tcp", host, port, error) from None
        super().__init__("tcp", session, listening)
        self.address: tuple[str, int] = listening.getsockname()

    def accept(self) -> socket.socket:
        """Return the next client, whose lines are not held back for longer ones."""
        client = super().accept()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return client
