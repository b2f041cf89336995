"""Packages that only some commands need: where one is missing, one line names it."""

from __future__ import annotations

import importlib.util

from arm_emulator.base.refusal import Refusal


def need_wheel(where: str, module: str, package: str) -> None:
    """Refuse to go on without a package, such as `rerun-sdk` for the module ``rerun``.

    Args:
        where: what needs it.
        module: that it brings.
        package: as pip knows it.

    Raises:
        Refusal: it is not installed.
    """
    if importlib.util.find_spec(module) is None:
        rule = "be installed"
        raise Refusal(where, f"Python package {package}", rule, "none", f"pip install {package}")
