"""The address at which a page is served, and its token."""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import re
import secrets
import socket
from dataclasses import dataclass

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.address import LOCAL, parse_address

EVERY = ("0.0.0.0", "::")  # all interfaces of this machine


@dataclass(frozen=True)
class PageAddress:
    """A host of this machine, and a TCP port.

    Attributes:
        host: name or address of an interface; by default browsers on this machine alone come.
        port: 0: any that is free.
    """

    host: str = LOCAL
    port: int = 0

    @classmethod
    def from_text(cls, text: str | int) -> PageAddress:
        """Return the address of a text [HOST:]PORT, or of a port.

        Raises:
            Refusal: it is neither.
        """
        return cls(*parse_address("page", "address", str(text)))

    @property
    def name(self) -> str:
        """The host as browsers find it."""
        host = socket.gethostname() if self.host in EVERY else self.host
        return f"[{host}]" if ":" in host else host

    def is_requested_by(self, host: str | None) -> bool:
        """Return whether browsers may ask for the page by a name or an address.

        A name of someone else's may resolve to this machine; an address can not be forged so.
        """
        if host in {self.host, self.name, LOCAL, "localhost", "::1"}:
            return True
        with contextlib.suppress(ValueError):
            return self.host in EVERY and bool(ipaddress.ip_address(host or ""))
        return False

    def choose_free_port(self) -> PageAddress:
        """Return this address with a port that is free now.

        Raises:
            Refusal: its port is taken, or the host is not one of this machine.
        """
        try:
            kind, *_, place = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)[0]
            with socket.socket(kind) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(place)
                return PageAddress(self.host, int(probe.getsockname()[1]))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise Refusal("page", "port", "be free", self.port) from error
            raise Refusal("page", "host", "be of this machine", self.host) from error

    def write_url(self, token: str) -> str:
        """Return the address for browsers, with the secret of the page."""
        return f"http://{self.name}:{self.port}/{token}/"


# A launcher that prints the address passes the token on in it; other users can read arguments.
VARIABLE = "ARM_EMULATOR_PAGE_TOKEN"
BYTES = 16


def make_token() -> str:
    """Return a new random token, safe in a path."""
    return secrets.token_urlsafe(BYTES)


def get_token() -> str:
    """Return the token of the page of this process: that of its launcher, or a new one."""
    token = os.environ.pop(VARIABLE, "")
    return token if re.fullmatch(r"[A-Za-z0-9_-]{20,}", token) else make_token()
