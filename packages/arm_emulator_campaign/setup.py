"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = "arm_emulator_campaign"
CORE = Path(__file__).resolve().parents[2] / "arm_emulator"
VERSION = re.search(r'VERSION = "(.*)"', (CORE / "version.py").read_text())

setup(
    name=NAME,
    version=VERSION[1],
    description="Many runs of one scenario: what varies, faults, requirements, search.",
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
    extras_require={"dask": ["distributed"], "search": ["cma", "optuna", "SALib"]},
    zip_safe=False,
    entry_points={
        "arm_emulator.commands": [
            "campaign = arm_emulator_campaign.commands.campaign",
            "faults = arm_emulator_campaign.commands.faults",
        ],
        "arm_emulator.card_compilers": [
            "campaign = arm_emulator_campaign.judging.card_kernels:compile_campaign_for_card",
        ],
        "arm_emulator.units": [
            "judges = arm_emulator_campaign.judging.program:judges_unit",
            "sampler = arm_emulator_campaign.judging.signals:sampler_unit",
        ],
    },
)
