"""Paths of configuration files: scenes, files next to them, files shipped with the emulator."""

import os
from pathlib import Path
from sysconfig import get_path

from arm_emulator.base.io.text_file import explain_missing_file
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.refusal import Refusal

# Files that may be next to a scene: parameters of servo and motion controller, and a demo.
BESIDE = ("servo", "motion", "demo")
ROBOTS = (".urdf", ".xacro")  # endings of robot descriptions, from which scenes can be made


def find_config_folder() -> Path:
    """Return the folder `config`: of the checkout, or installed with the ROS package."""
    checkout = Path(__file__).resolve().parents[3] / "config"
    if checkout.is_dir():
        return checkout
    for installed in _list_installed_folders():
        if installed.is_dir():
            return installed
    raise Refusal(
        "arm_emulator",
        "AMENT_PREFIX_PATH",
        "hold an installed arm_emulator",
        os.environ.get("AMENT_PREFIX_PATH", "nothing"),
        "source install/setup.bash first",
    )


def check_own(where: str, file: Path) -> None:
    """Refuse to write over a file of the emulator or of an installed package.

    Raises:
        Refusal: the file is one of these, or a link to one.
    """
    real = Path(os.path.realpath(file))
    folders = [find_config_folder(), *map(Path, (get_path("purelib"), get_path("platlib")))]
    folders += _list_installed_folders()
    if real.exists() and any(real.is_relative_to(os.path.realpath(folder)) for folder in folders):
        raise Refusal(
            where,
            f"file {file}",
            "be one of yours, to be written into",
            "a shipped one",
            f"a copy of it, such as `cp -r {real.parent} mine`",
        )


def _list_installed_folders() -> list[Path]:
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), get_path("data")]
    return [Path(prefix) / "share" / "arm_emulator" / "config" for prefix in prefixes if prefix]


def find_config(name: str, ending: str, kind: str = ".") -> Path:
    """Return the file that `name` means: a path, or the name of a shipped file.

    Args:
        name: a path, or a bare name such as ``three_axis``.
        ending: of the file, such as ``.yaml``.
        kind: the folder below `config` where bare names are looked up.

    Raises:
        Refusal: there is no such file.
    """
    path = Path(name)
    reason = explain_missing_file(path)
    if reason is None:
        if path.suffix in ROBOTS:
            valid = f"what `arm_emulator new {name}` makes of it"
            raise Refusal("arm_emulator", f"file {name}", "be a scene", "a robot", valid)
        return path
    folder = find_config_folder() / kind
    shipped = _find_shipped(name, ending, kind)
    if shipped is not None:
        return shipped
    available = ", ".join(sorted(file.stem for file in folder.glob(f"*{ending}")))
    raise Refusal("arm_emulator", f"file {name}", "exist", reason, available or None)


def find_scene(name: str | Path) -> Path:
    """Return the absolute path of the scene that `name` means; links in it are kept.

    Raises:
        Refusal: there is no such file.
    """
    return Path(os.path.abspath(find_config(str(name), ".yaml")))


def find_beside(scene: Path, kind: str) -> Path:
    """Return the file that belongs to a scene, by one rule for all commands and launch files.

    The scene's key `kind` names it, relative to the scene file, or by the name of one that comes
    with the emulator. Without the key it is ``KIND/NAME.yaml`` next to ``NAME.yaml``.

    Args:
        scene: the scene file.
        kind: one of `BESIDE`.

    Raises:
        Refusal: there is no such file; names the folders searched and the remedy.
    """
    named = read_yaml(scene).get(kind)
    if named is not None and (not isinstance(named, str) or not named):
        raise Refusal(scene.name, kind, "be the name of a file", repr(named))
    file = scene.parent / (named or f"{kind}/{scene.stem}.yaml")
    reason = explain_missing_file(file)
    if reason is None:
        return file
    shipped = _find_shipped(named, ".yaml", kind) if named else None
    if shipped is not None:
        return shipped
    valid = f"write that file, or name one in the scene: `{kind}: FILE`"
    raise Refusal(scene.name, f"{kind} parameters", f"be in {file}", reason, valid)


def _find_shipped(name: str, ending: str, kind: str) -> Path | None:
    """Return the file of a bare name that comes with the emulator, if there is one."""
    if Path(name).name != name:
        return None
    file = find_config_folder() / kind / f"{name.removesuffix(ending)}{ending}"
    return file if explain_missing_file(file) is None else None
