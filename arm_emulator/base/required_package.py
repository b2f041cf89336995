"""Python packages: if one is missing, one line names it."""

import importlib.util
import os
import sys
from types import TracebackType

from arm_emulator.base.refusal import Refusal

# Packages of pip by modules that are called otherwise.
PACKAGES = {
    "PIL": "pillow",
    "_cffi_backend": "cffi",
    "can": "python-can",
    "coal": "pin",
    "elftools": "pyelftools",
    "pinocchio": "pin",
    "rerun": "rerun-sdk",
    "rerun_cli": "rerun-sdk",
    "serial": "pyserial",
    "yaml": "PyYAML",
}


def name_package(module: str) -> str:
    """Return what pip calls the package of a module."""
    return PACKAGES.get(module, module)


def require_package(where: str, module: str, package: str) -> None:
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


def refuse_missing_module(where: str, module: str) -> Refusal:
    """Return the refusal of what cannot go on without a module."""
    remedy = f"pip install {name_package(module)}"
    return Refusal(where, f"Python module {module}", "be installed", "none", remedy)


def refuse_missing_modules(where: str) -> None:
    """Let this process end with a line and code 2 when a module of others cannot be found.

    It is for programs whose imports stand at the top of their file.
    """
    default_hook = sys.excepthook

    def handle_exception(
        kind: type[BaseException], error: BaseException, trace: TracebackType | None
    ) -> None:
        top = (getattr(error, "name", "") or "").partition(".")[0]
        if not isinstance(error, ModuleNotFoundError) or top in ("", "arm_emulator"):
            default_hook(kind, error, trace)
            return
        print(refuse_missing_module(where, top), file=sys.stderr, flush=True)
        os._exit(2)  # Python would end with 1

    sys.excepthook = handle_exception
