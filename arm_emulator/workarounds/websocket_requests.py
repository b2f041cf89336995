"""Requests to a server of viser, answered before viser answers them, and an end of it in time.

Versions: viser 1.1, websockets 16. Reason: viser has no hook for requests, for its end, and for
its log; it hands its own check to `websockets.asyncio.server.serve`, which is replaced while a
server starts. At its end that server waits for 10 s for a browser that does not answer, such as
one on a computer that sleeps. A connection may end before its first request is complete, such as
that of a port scan. It is logged with a traceback until viser has answered a request.
Test: test/toolchain/test_workarounds.py, `test_viser_has_no_hook_for_requests`.
"""

import asyncio
import contextlib
import importlib
import logging
from collections.abc import Callable, Iterator
from typing import Any

Answer = Callable[[Any, Any], Any]
FAREWELL = 0.5  # s, wall: for browsers to close their connections at the end of the server


@contextlib.contextmanager
def answer_requests(answer: Callable[[Any, Any, Answer], Any]) -> Iterator[None]:
    """Let a function answer all requests to the server that is started in this block.

    At the end of the server, connections that do not close are cut.

    Args:
        answer: gets connection, request and viser's own answer; returns a response, or None for the
            websocket.
    """
    server: Any = importlib.import_module("websockets.asyncio.server")
    plain = server.serve

    class Serve(plain):  # type: ignore[misc, valid-type]
        """Serves as `plain` does, and ends in time."""

        async def __aexit__(self, *why: object) -> None:
            self.server.close()
            if handlers := list(self.server.handlers.values()):
                await asyncio.wait(handlers, timeout=FAREWELL)
            for connection, handler in list(self.server.handlers.items()):
                if connection.protocol.state.name == "CONNECTING":
                    handler.cancel()
                connection.transport.abort()
            await super().__aexit__(*why)

    def serve_page(*arguments: Any, process_request: Answer, **named: Any) -> Any:
        def respond_or_pass(connection: Any, request: Any) -> Any:
            return answer(connection, request, process_request)

        log = logging.getLogger("websockets.server")
        log.addFilter(_is_of_a_request)
        return Serve(*arguments, process_request=respond_or_pass, logger=log, **named)

    server.serve = serve_page
    try:
        yield
    finally:
        server.serve = plain


def _is_of_a_request(record: logging.LogRecord) -> bool:
    return record.getMessage() != "opening handshake failed"
