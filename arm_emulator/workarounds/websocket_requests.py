"""Requests to a server of viser, answered before viser answers them.

Versions: viser 1.1, websockets 16. Reason: viser has no hook for requests; it hands its own check
to `websockets.asyncio.server.serve`, which is replaced while a server starts.
Test: test/test_workarounds.py, `test_viser_has_no_hook_for_requests`.
"""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterator
from typing import Any

Answer = Callable[[Any, Any], Any]


@contextlib.contextmanager
def answer_requests(answer: Callable[[Any, Any, Answer], Any]) -> Iterator[None]:
    """Let a function answer all requests to the server that is started in this block.

    Args:
        answer: gets connection, request and viser's own answer; returns a response, or None for a
            websocket.
    """
    server: Any = importlib.import_module("websockets.asyncio.server")
    plain = server.serve

    def serve(*arguments: Any, process_request: Answer, **named: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            return answer(connection, request, process_request)

        return plain(*arguments, process_request=process, **named)

    server.serve = serve
    try:
        yield
    finally:
        server.serve = plain
