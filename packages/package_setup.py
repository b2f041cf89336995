"""Setup that the packages beside the core share."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from setuptools import find_packages, setup

CORE = Path(__file__).resolve().parents[1] / "arm_emulator"


def set_up(
    name: str,
    description: str,
    needs: tuple[str, ...] = (),
    entry_points: Mapping[str, Sequence[str]] | None = None,
    **more: Any,
) -> None:
    """Install a package, as colcon and pip call for it in its folder.

    Each file of its folder `commands` is a command, named after the file.

    Args:
        name: of the package.
        description: in one line.
        needs: packages that it imports, beside the core.
        entry_points: by which the core finds what is not a command.
        **more: further arguments of `setuptools.setup`.
    """
    commands = sorted(file.stem for file in Path(name).glob("commands/[!_]*.py"))
    version = re.search(r'VERSION = "(.*)"', (CORE / "version.py").read_text())
    assert version is not None, "the core states its version"
    sources = ("**/*.c", "**/*.h", "**/*.cpp", "**/*.hpp", "py.typed", "examples/*/*")
    setup(
        name=name,
        version=version[1],
        description=description,
        license="Apache-2.0",
        maintainer="arm_emulator developers",
        maintainer_email="arm_emulator@example.org",
        packages=find_packages(include=[name, f"{name}.*"]),
        package_data={name: [*sources]},
        data_files=[
            ("share/ament_index/resource_index/packages", [f"resource/{name}"]),
            (f"share/{name}", ["package.xml"]),
        ],
        python_requires=">=3.11",
        install_requires=["arm_emulator", *needs],
        zip_safe=False,
        entry_points={
            **(entry_points or {}),
            "arm_emulator.commands": [
                f"{command.replace('_', '-')} = {name}.commands.{command}" for command in commands
            ],
        },
        **more,
    )
