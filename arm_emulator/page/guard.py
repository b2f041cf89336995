"""Access to the page: with its token, under its own address.

A browser sends the requests of any page that is open in it to this machine, too. So the token alone
opens the page, a page of another origin gets nothing, and neither does a name that resolves to this
machine (DNS rebinding).
"""

from __future__ import annotations

import hmac
import http
import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from arm_emulator.page.entrance import TEXT, is_at_entrance
from arm_emulator.page.page_address import PageAddress

COOKIE = "arm_emulator_page"
HERE = PageAddress()


class Guard:
    """Decides on requests.

    Args:
        token: secret of the page, in the query of its first request and in a cookie afterwards.
        address: at which the page is served.
    """

    def __init__(self, token: str, address: PageAddress = HERE) -> None:
        self._token, self._address = token, address

    def reason(self, path: str, headers: Any) -> str:
        """Return why a request is refused; empty: it is not.

        Args:
            path: of the request, with its query.
            headers: of the request, with `get`.
        """
        host = headers.get("Host", "")
        if not self._address.is_asked_by(urlsplit(f"//{host}").hostname):
            return "the page is not asked for by its own address"
        origin = headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return "the request comes from another page"
        if not any(hmac.compare_digest(one, self._token) for one in _tokens(path, headers)):
            return "the token is missing or wrong: open the whole address that was printed"
        return ""

    def cookie(self, path: str) -> str:
        """Return the cookie to set in the answer to a request with a token; empty: none."""
        if "token" not in parse_qs(urlsplit(path).query):
            return ""
        return f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"


def _tokens(path: str, headers: Any) -> Iterator[str]:
    yield from parse_qs(urlsplit(path).query).get("token", ())
    try:
        cookies = SimpleCookie(headers.get("Cookie", ""))
    except CookieError:
        return
    if COOKIE in cookies:
        yield cookies[COOKIE].value


@contextmanager
def guarded(guard: Guard) -> Iterator[None]:
    """Let the server that is started in this block ask a guard about every request.

    Its library has no hook for that: it hands its own check to `websockets`, which is wrapped here.
    """
    server: Any = importlib.import_module("websockets.asyncio.server")
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    plain = server.serve

    def answer(status: http.HTTPStatus, kind: str, text: str) -> Response:
        body = text.encode()
        lines = {"Content-Type": f"text/{kind}", "Content-Length": str(len(body))}
        return Response(status.value, status.phrase, Headers(lines), body)

    def serve(*given: Any, process_request: Callable[[Any, Any], Any], **named: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            reason = guard.reason(request.path, request.headers)
            if reason:
                return answer(http.HTTPStatus.FORBIDDEN, "plain", f"arm_emulator: {reason}\n")
            if is_at_entrance(request.path) and "Upgrade" not in request.headers:
                response = answer(http.HTTPStatus.OK, "html", TEXT)
            else:
                response = process_request(connection, request)
            if response is not None and (cookie := guard.cookie(request.path)):
                response.headers["Set-Cookie"] = cookie
            return response

        return plain(*given, process_request=checked, **named)

    server.serve = serve
    try:
        yield
    finally:
        server.serve = plain
