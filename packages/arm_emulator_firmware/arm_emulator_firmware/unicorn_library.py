"""Unicorn, the processor's emulator: headers and shared library of its Python package."""

import ctypes
import importlib.util
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from arm_emulator.extension.base import Refusal


def find_package(package: str, distribution: str) -> Path:
    """Return the folder of a Python package that only this command needs.

    Raises:
        Refusal: it is not installed.
    """
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise Refusal(
            "firmware",
            f"the Python package {distribution}",
            "be installed",
            "none",
            f"pip install {distribution}",
        )
    return Path(spec.submodule_search_locations[0])


def find_headers() -> Path:
    """Return the folder of Unicorn's headers.

    Raises:
        Refusal: it is not installed, or without headers.
    """
    headers = find_package("unicorn", "unicorn") / "include"
    if not (headers / "unicorn/unicorn.h").is_file():
        rule = "come with its headers"
        raise Refusal("firmware", "Unicorn", rule, f"none in {headers}", "pip install unicorn")
    return headers


def read_version() -> str:
    """Return the version of the installed Unicorn."""
    try:
        return version("unicorn")
    except PackageNotFoundError:
        return "unknown"


@cache
def load_unicorn() -> ctypes.CDLL:
    """Load Unicorn for libraries that are loaded later.

    Raises:
        Refusal: it is not installed, or does not load.
    """
    folder = find_package("unicorn", "unicorn") / "lib"
    files = sorted(folder.glob("libunicorn.so*"))
    if not files:
        rule = "come with its library"
        raise Refusal("firmware", "Unicorn", rule, f"none in {folder}", "pip install unicorn")
    try:
        return ctypes.CDLL(str(files[0]), mode=ctypes.RTLD_GLOBAL)
    except OSError as error:
        raise Refusal("firmware", "Unicorn", "be loaded by the system", error) from None
