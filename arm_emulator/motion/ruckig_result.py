"""Calls of ruckig, whose failures are one kind of exception."""

from __future__ import annotations

from collections.abc import Callable

import ruckig


def found(call: Callable[[], ruckig.Result]) -> None:
    """Call ruckig for a motion.

    Raises:
        ArithmeticError: it finds none. Some of its results have no name in Python (-101, a motion
            of hours), which is a ValueError there; others are a RuckigError of many lines.
    """
    try:
        result = call()
    except (ruckig.RuckigError, ValueError) as error:
        line = next(line for line in f"{error}\n?".splitlines() if line.strip())
        raise ArithmeticError(line.strip()) from None
    if int(result) < 0:
        raise ArithmeticError(str(result))
