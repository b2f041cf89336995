"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "arm_emulator_identification"
CORE = Path(__file__).resolve().parents[2] / "arm_emulator"
VERSION = re.search(r'VERSION = "(.*)"', (CORE / "version.py").read_text())

setup(
    name=NAME,
    version=VERSION[1],
    description="A scene's numbers from records of its motion; validation by real machines.",
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
    install_requires=["arm_emulator", "arm_emulator_fleet"],
    zip_safe=False,
    entry_points={
        "arm_emulator.commands": [
            "accuracy = arm_emulator_identification.commands.accuracy",
            "identify = arm_emulator_identification.commands.identify",
            "validate = arm_emulator_identification.commands.validate",
        ],
    },
)
