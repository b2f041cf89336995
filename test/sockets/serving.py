"""A server of a session in a thread of its own."""

import contextlib
import threading
from collections.abc import Iterator
from typing import Protocol, TypeVar

from arm_emulator import Session


class Server(Protocol):
    """Serves until it is closed."""

    def serve(self) -> None: ...

    def close(self) -> None: ...


AnyServer = TypeVar("AnyServer", bound=Server)


@contextlib.contextmanager
def serving(server: AnyServer, session: Session) -> Iterator[AnyServer]:
    """Serve a session; both are closed at the end."""
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        yield server
    finally:
        server.close()
        thread.join()
        session.close()
