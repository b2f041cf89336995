"""Addresses of sockets, as people give them."""

from __future__ import annotations

import re

from arm_emulator.base.refusal import Refusal


def host_and_port(where: str, text: str) -> tuple[str, int]:
    """Return host and port of `[HOST:]PORT`; without a host this machine's own.

    Raises:
        Refusal: another form.
    """
    host, _, port = text.rpartition(":")
    if not re.fullmatch(r"[0-9]{1,5}", port):
        raise Refusal(where, "--listen", "be PORT or HOST:PORT", text)
    return host or "127.0.0.1", int(port)
