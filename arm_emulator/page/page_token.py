"""The secret in a page's address: a new one for every run."""

from __future__ import annotations

import os
import re
import secrets

# A launcher that prints the address passes the token on in it; other users can read arguments.
VARIABLE = "ARM_EMULATOR_PAGE_TOKEN"
BYTES = 16


def new_token() -> str:
    """Return a token that nobody knows yet; it can stand in a path as it is."""
    return secrets.token_urlsafe(BYTES)


def page_token() -> str:
    """Return the token of the page of this process: that of its launcher, or a new one."""
    given = os.environ.pop(VARIABLE, "")
    return given if re.fullmatch(r"[A-Za-z0-9_-]{20,}", given) else new_token()
