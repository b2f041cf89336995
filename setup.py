"""Install the package: its Python packages, the scenes and the launch files.

By colcon as a ROS package; by pip without ROS, for physics, doors and the command line.
"""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "arm_emulator"
HERE = Path(__file__).resolve().parent  # colcon links this file elsewhere
BESIDE = {  # by their names without `arm_emulator_`: the setup of each package in packages/
    file.parent.name.removeprefix(f"{NAME}_"): file.read_text()
    for file in sorted(HERE.glob(f"packages/{NAME}_*/setup.py"))
}
PACKAGES = ("arm_emulator", "emulator_node", "servo_node", "motion_controller_node")


def list_share(folder: str) -> list[tuple[str, list[str]]]:
    """List every file below `folder` with the place below share/ where it is installed."""
    files: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            files.setdefault(f"share/{NAME}/{path.parent.as_posix()}", []).append(path.as_posix())
    return list(files.items())


def list_wheels(part: str) -> list[str]:
    """Name the packages in a part of requirements*.txt, which alone have versions."""
    files = "".join(file.read_text() for file in sorted(HERE.glob("requirements*.txt")))
    parts = dict(re.findall(r"^# --- (.*)\n((?:.+\n)*)", files, re.M))
    return re.findall(r"^([\w.-]+)==", parts[part], re.M)


def require_beside(package: str, extra: str = "") -> list[str]:
    """Require a package of this checkout, in packages/, and the one that it needs."""
    name = f"{NAME}_{package}"
    needs_fleet = package != "fleet" and f'"{NAME}_fleet"' in BESIDE[package]
    needed = require_beside("fleet") if needs_fleet else []
    return [*needed, f"{name}{extra} @ {(HERE / 'packages' / name).as_uri()}"]


VERSION = re.search(r'VERSION = "(.*)"', (HERE / "arm_emulator/version.py").read_text())

setup(
    name=NAME,
    version=VERSION[1],
    description="An emulated arm robot, its servo and its motion controller as ROS 2 nodes.",
    license="Apache-2.0",
    maintainer="arm_emulator developers",
    maintainer_email="arm_emulator@example.org",
    packages=find_packages(include=[name + tail for name in PACKAGES for tail in ("", ".*")]),
    package_data={
        **{name: [f"**/*{end}" for end in (".c", ".h", ".cpp", ".hpp")] for name in PACKAGES},
        "arm_emulator.servo.c": ["template/*"],
        "": ["py.typed"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "LICENSE"]),
        (f"share/{NAME}/hook", ["resource/hook/path.dsv"]),
        *list_share("config"),
        *list_share("launch"),
    ],
    python_requires=">=3.11",
    install_requires=list_wheels("numbers, robots, files, pictures, command line"),
    extras_require={
        **{package: require_beside(package) for package in BESIDE},
        "dask": require_beside("campaign", "[dask]"),
        "search": require_beside("campaign", "[search]"),
        "test": ["pytest"],  # colcon test then knows the runner
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "arm_emulator = arm_emulator.__main__:main",
            "emulator_node = arm_emulator.cli.node_main:emulator",
            "motion_controller_node = arm_emulator.cli.node_main:motion_controller",
            "servo_node = arm_emulator.cli.node_main:servo",
        ],
    },
)
