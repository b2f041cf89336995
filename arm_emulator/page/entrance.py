"""The first answer to a browser, which asks again for the dark or the light page, as it prefers."""

from __future__ import annotations

from urllib.parse import parse_qs, urlsplit

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


def is_at_entrance(path: str) -> bool:
    """Return whether a request is the first one of a browser.

    Args:
        path: of the request, with its query.
    """
    address = urlsplit(path)
    return address.path == "/" and LOOK not in parse_qs(address.query)
