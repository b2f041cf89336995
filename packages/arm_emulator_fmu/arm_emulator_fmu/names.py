"""Names of variables, as FMI writes them.

The standard's structured names (``joints.'joint 1'.gear.stiffness``) are trees in importers, but
take printable ASCII only. Where a scene has another name in it, all names are flat.
"""

import re
from collections.abc import Iterable, Sequence

Parts = Sequence[str]  # of a name, from the root of the tree on

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")


def find_convention(names: Iterable[Parts]) -> str:
    """Return the attribute `variableNamingConvention` that fits all names."""
    ascii_only = all(
        part and part.isascii() and part.isprintable() for name in names for part in name
    )
    return "structured" if ascii_only else "flat"


def write_name(name: Parts, index: int | None, convention: str) -> str:
    """Return a name as the convention writes it; names that differ are written differently.

    Args:
        name: its parts.
        index: of an element, from 1; None: of the whole.
        convention: see `find_convention`.
    """
    bracket = "" if index is None else f"[{index}]"
    if convention == "flat":
        return ".".join(_join_lines(part) for part in name) + bracket
    return (
        ".".join(part if _PLAIN.fullmatch(part) else _quote_name(part) for part in name) + bracket
    )


def make_identifier(name: str) -> str:
    """Return a name as an identifier of C, of at most 60 characters."""
    plain = re.sub(r"[^A-Za-z_0-9]", "_", name)[:60]
    return plain if _PLAIN.fullmatch(plain) else f"_{plain}"[:60]


def _quote_name(part: str) -> str:
    return "'" + re.sub(r"(['\"\\])", r"\\\1", part) + "'"


def _join_lines(part: str) -> str:
    # XML takes no control characters, and not all surrogates; the backslash marks what is escaped.
    return "".join(
        c if (c.isprintable() and c != "\\") else c.encode("unicode_escape").decode() for c in part
    )
