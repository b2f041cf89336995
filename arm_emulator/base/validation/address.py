"""Addresses of sockets, as people give them."""

import re

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.count import check_count

LOCAL = "127.0.0.1"


def parse_address(where: str, quantity: str, text: str) -> tuple[str, int]:
    """Return host and port of `[HOST:]PORT`; without a host this machine's own.

    An IPv6 address stands in brackets.

    Raises:
        Refusal: another form.
    """
    host, _, port = text.rpartition(":")
    if not re.fullmatch(r"[0-9]{1,9}", port):
        raise Refusal(where, quantity, "be [HOST:]PORT", text, "8080, 0.0.0.0:8080")
    check_count(where, f"{quantity}, port", int(port), 0, 65535)
    return host.strip("[]") or LOCAL, int(port)


def refuse_taken_address(
    where: str, host: str, port: int, error: OSError | OverflowError
) -> Refusal:
    """Return the refusal of an address where a server cannot listen."""
    why = getattr(error, "strerror", None) or error
    return Refusal(where, f"address {host}:{port}", "be free", why)
