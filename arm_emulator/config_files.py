"""Where the configuration files are that come with the emulator."""

import os
from pathlib import Path

from arm_emulator.refusal import Refusal


def config_folder() -> Path:
    """Return the folder `config`: of the checkout, or installed with the ROS package."""
    checkout = Path(__file__).resolve().parents[1] / "config"
    if checkout.is_dir():
        return checkout
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        installed = Path(prefix) / "share" / "arm_emulator" / "config"
        if installed.is_dir():
            return installed
    raise Refusal(
        "arm_emulator",
        "AMENT_PREFIX_PATH",
        "hold an installed arm_emulator",
        os.environ.get("AMENT_PREFIX_PATH", "nothing"),
        "source install/setup.bash first",
    )


def find_config(name: str, ending: str, kind: str = ".") -> Path:
    """Return the file that `name` means: a path, or the name of a file that comes along.

    Args:
        name: a path, or a bare name such as ``three_axis``.
        ending: of the file, such as ``.yaml``.
        kind: the folder below `config` where bare names are looked up.

    Raises:
        Refusal: there is no such file.
    """
    path = Path(name)
    if path.is_file():
        return path
    folder = config_folder() / kind
    if path.name == name:
        file = folder / f"{name.removesuffix(ending)}{ending}"
        if file.is_file():
            return file
    known = ", ".join(sorted(file.stem for file in folder.glob(f"*{ending}")))
    raise Refusal("arm_emulator", f"file {name}", "exist", "no such file", known or None)
