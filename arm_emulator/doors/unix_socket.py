"""The machine behind a Unix socket: lines of JSON, see `json_lines`, for programs beside it."""

from __future__ import annotations

import contextlib
import socket
import stat
from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.doors.json_lines import JsonLinesServer
from arm_emulator.machine.session import Session


class UnixSocketServer(JsonLinesServer):
    """Answers clients that connect to a file, which the user alone may open.

    Attributes:
        path: the file; it goes when serving ends.

    Args:
        session: the machine.
        path: a name that is free, or a socket that a server has left.

    Raises:
        Refusal: it cannot listen there.
    """

    def __init__(self, session: Session, path: str | Path) -> None:
        self.path = Path(path)
        listening = socket.socket(socket.AF_UNIX)
        try:
            if _is_left(self.path):
                self.path.unlink()
            listening.bind(str(self.path))
            self.path.chmod(stat.S_IRUSR | stat.S_IWUSR)
            listening.listen(1)
        except (OSError, ValueError) as error:
            listening.close()
            why = getattr(error, "strerror", None) or error
            raise Refusal("unix-socket", "path", "be free", f"{path}: {why}") from None
        super().__init__("unix-socket", session, listening)

    def serve(self) -> None:
        """Serve until `close`."""
        try:
            super().serve()
        finally:
            self.path.unlink(missing_ok=True)


def _is_left(path: Path) -> bool:
    """Return whether a file is a socket on which nobody listens."""
    with contextlib.suppress(FileNotFoundError), socket.socket(socket.AF_UNIX) as client:
        if stat.S_ISSOCK(path.lstat().st_mode):
            try:
                client.connect(str(path))
            except ConnectionRefusedError:
                return True
    return False
