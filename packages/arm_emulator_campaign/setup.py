"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from package_setup import set_up

set_up(
    "arm_emulator_campaign",
    "Many runs of one scenario: what varies, faults, requirements, search.",
    needs=("arm_emulator_fleet",),
    extras_require={"dask": ["distributed"], "search": ["cma", "optuna", "SALib"]},
    entry_points={
        "arm_emulator.card_compilers": [
            "campaign = arm_emulator_campaign.judging.card_kernels:compile_campaign_for_card",
        ],
        "arm_emulator.units": [
            "judges = arm_emulator_campaign.judging.program:judges_unit",
            "sampler = arm_emulator_campaign.judging.signals:sampler_unit",
        ],
    },
)
