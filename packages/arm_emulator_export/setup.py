"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "arm_emulator_export"
CORE = Path(__file__).resolve().parents[2] / "arm_emulator"
VERSION = re.search(r'VERSION = "(.*)"', (CORE / "version.py").read_text())

setup(
    name=NAME,
    version=VERSION[1],
    description="Files of a scene for ros2_control, MoveIt and Foxglove.",
    license="Apache-2.0",
    maintainer="arm_emulator developers",
    maintainer_email="arm_emulator@example.org",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    python_requires=">=3.11",
    install_requires=["arm_emulator"],
    zip_safe=False,
    entry_points={
        "arm_emulator.commands": [
            "foxglove = arm_emulator_export.commands.foxglove",
            "moveit-config = arm_emulator_export.commands.moveit_config",
            "ros2-control = arm_emulator_export.commands.ros2_control",
        ],
    },
)
