"""Optional packages: if one is missing, one line names it."""

from __future__ import annotations

import importlib.util

from arm_emulator.base.refusal import Refusal


def need_wheel(where: str, module: str, package: str) -> None:
    """Refuse to continue without a package, such as `rerun-sdk` for the module ``rerun``.

    Args:
        where: the feature that needs it.
        module: the module that it provides.
        package: its name for pip.

    Raises:
        Refusal: it is not installed.
    """
    if importlib.util.find_spec(module) is None:
        rule = "be installed"
        raise Refusal(where, f"Python package {package}", rule, "none", f"pip install {package}")
