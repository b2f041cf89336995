"""Install the package beside arm_emulator, which finds its library by its entry point."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "arm_emulator_fleet"
CORE = Path(__file__).resolve().parents[2] / "arm_emulator"
VERSION = re.search(r'VERSION = "(.*)"', (CORE / "version.py").read_text())

setup(
    name=NAME,
    version=VERSION[1],
    description="Many arms of one scene in one process, advanced side by side.",
    license="Apache-2.0",
    maintainer="arm_emulator developers",
    maintainer_email="arm_emulator@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["**/*.c", "**/*.h", "**/*.cpp", "**/*.hpp", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.11",
    install_requires=["arm_emulator"],
    zip_safe=False,
    entry_points={
        "arm_emulator.scene_units": [
            "fleet = arm_emulator_fleet.unit:build_fleet_unit",
        ],
        "arm_emulator.card_compilers": [
            "fleet = arm_emulator_fleet.gpu_compiler:compile_scene_for_card",
        ],
    },
)
