"""The server of a page: guarded, and in our looks."""

import contextlib
import dataclasses
import gzip
import hmac
import io
from collections.abc import Callable
from contextlib import AbstractContextManager
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs, urlsplit

from arm_emulator.extension.base import Refusal, require_package
from arm_emulator.extension.page import PageAddress, answer_requests, get_token


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
        require_package("the page", "viser", "viser")
        address = PageAddress.from_text(at).choose_free_port()
        import viser

        token = get_token()
        # It prints addresses without the token, with any option.
        with guard_server(Guard(token, address)), contextlib.redirect_stdout(io.StringIO()):
            try:
                self.server: Any = viser.ViserServer(address.host, address.port, verbose=False)
            except (OSError, RuntimeError) as error:
                raise Refusal("page", "port", "be free", address.port) from error
        self.url = address.write_url(token)
        apply_theme(self.server)
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


def apply_theme(server: Any) -> None:
    """Give a server of viser the looks of our pages."""
    gui = server.gui
    gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    gui.main_panel.dock_right()
    gui.main_panel.set_width(WIDTH)
    gui.add_html(STYLE)


# A browser sends the requests of any page that is open in it to this machine, too. So the token
# alone opens the page. A page of another origin gets nothing, nor does a name that resolves to this
# machine (DNS rebinding). The token is the first folder of the path, from which the browser
# takes all its further requests, that of the websocket among them. There is no cookie: browsers
# send cookies to every port of a host (RFC 6265, 8.5).

HERE = PageAddress()


@dataclasses.dataclass(frozen=True)
class RequestVerdict:
    """Decision on a request.

    Attributes:
        status: OK, or that of its refusal.
        text: reason of its refusal.
        path: what it asks for below the folder of the token.
    """

    status: HTTPStatus
    text: str = ""
    path: str = ""


class Guard:
    """Decides on requests.

    Args:
        token: secret of the page, the first folder of the path of every request.
        address: at which the page is served.
    """

    def __init__(self, token: str, address: PageAddress = HERE) -> None:
        self._token, self._address = token, address

    def judge_request(self, path: str, headers: Any) -> RequestVerdict:
        """Return the decision on a request.

        Args:
            path: of the request, with its query.
            headers: of the request, with `get`.
        """
        try:
            host = headers.get("Host", "")
            hostname = urlsplit(f"//{host}").hostname
            origin = headers.get("Origin")
            own = origin is None or urlsplit(origin).netloc == host
        except (ValueError, LookupError):  # no address, or a header that came twice
            return RequestVerdict(HTTPStatus.BAD_REQUEST, "the request is malformed")
        folders = path.partition("?")[0].split("/")
        if not (path[:1] == "/" and path.isascii() and path.isprintable()) or ".." in folders:
            return RequestVerdict(HTTPStatus.BAD_REQUEST, "the path of the request is malformed")
        if not self._address.is_requested_by(hostname):
            reason = "the page is not asked for by its own address"
            return RequestVerdict(HTTPStatus.FORBIDDEN, reason)
        if not own:
            return RequestVerdict(HTTPStatus.FORBIDDEN, "the request comes from another page")
        if not hmac.compare_digest(folders[1].encode(), self._token.encode()):
            reason = "the token is missing or wrong: open the whole address that was printed"
            return RequestVerdict(HTTPStatus.FORBIDDEN, reason)
        below = path[1 + len(self._token) :]
        return RequestVerdict(HTTPStatus.OK, path=below if below[:1] == "/" else f"/{below}")


def _put_title(response: Any) -> None:
    """Put our title in the place of that of the library, which it has no setting for."""
    if not response.headers.get("Content-Type", "").startswith("text/html"):
        return
    packed = response.headers.get("Content-Encoding") == "gzip"
    text = gzip.decompress(response.body) if packed else response.body
    titled = text.replace(b"<title>Viser</title>", b"<title>arm_emulator</title>", 1)
    if titled != text:
        response.body = gzip.compress(titled) if packed else titled
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))


def guard_server(guard: Guard) -> AbstractContextManager[None]:
    """Let the server that is started in this block ask a guard about every request."""

    def make_response(status: HTTPStatus, kind: str, text: str) -> Any:
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        body = text.encode()
        lines = {"Content-Type": f"text/{kind}", "Content-Length": str(len(body))}
        return Response(status.value, status.phrase, Headers(lines), body)

    def answer_request(
        connection: Any, request: Any, process_request: Callable[[Any, Any], Any]
    ) -> Any:
        verdict = guard.judge_request(request.path, request.headers)
        if verdict.status is not HTTPStatus.OK:
            return make_response(verdict.status, "plain", f"arm_emulator: {verdict.text}\n")
        if is_landing_page(verdict.path) and "Upgrade" not in request.headers:
            return make_response(HTTPStatus.OK, "html", TEXT)
        below = dataclasses.replace(request, path=verdict.path)
        try:
            response = process_request(connection, below)
        except OSError:  # a folder, or a name that no file can have
            return make_response(HTTPStatus.NOT_FOUND, "plain", "arm_emulator: no such file\n")
        except (ValueError, LookupError):
            return make_response(
                HTTPStatus.BAD_REQUEST, "plain", "arm_emulator: malformed request\n"
            )
        if response is not None:
            response.headers["Referrer-Policy"] = "no-referrer"  # the path has the token
            _put_title(response)
        return response

    return answer_requests(answer_request)


LOOK = "look"  # in the query: the browser has been here
# `darkMode` is what the library of the page looks for.
TEXT = """<!doctype html><meta charset="utf-8"><meta name="referrer" content="no-referrer">
<title>arm_emulator</title><script>
const to = new URL(location.href);
if (!to.pathname.endsWith("/")) to.pathname += "/";
const dark = matchMedia("(prefers-color-scheme: dark)").matches;
to.searchParams.set("LOOK", dark ? "dark" : "light");
if (dark) to.searchParams.set("darkMode", "");
location.replace(to);
</script><noscript>The page needs JavaScript.</noscript>
""".replace("LOOK", LOOK)


def is_landing_page(path: str) -> bool:
    """Return whether a request is the first one of a browser.

    Args:
        path: of the request, with its query.
    """
    address = urlsplit(path)
    return address.path == "/" and LOOK not in parse_qs(address.query)
