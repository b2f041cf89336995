"""A run of a campaign as a machine gets it, alone or in lanes."""

from __future__ import annotations

from typing import NamedTuple

from arm_emulator.campaign.campaign_file import Campaign
from arm_emulator.campaign.case import Case
from arm_emulator.campaign.fault import changes_of
from arm_emulator.campaign.scenario import Scenario, ticks_of
from arm_emulator.machine.change import Change, NumberChange
from arm_emulator.servo.servo_config import ServoConfig


class BoundCase(NamedTuple):
    """A run with all that it draws in its file.

    Attributes:
        scenario, servo: of this run.
        changes: what its faults and forks set, with the ticks before which that happens, ascending.
        last: tick at which it ends.
    """

    scenario: Scenario
    servo: ServoConfig
    changes: list[tuple[int, Change]]
    last: int


def bound(campaign: Campaign, case: Case) -> BoundCase:
    """Return a run of a campaign as a machine gets it.

    Raises:
        Refusal: a drawn value that is out of range.
    """
    drawn = campaign.draws_sections
    given = campaign.with_values(case.values) if drawn else campaign.nominal
    scenario, faults, servo = given
    there = [fault for name, fault in faults.items() if name not in case.without]
    changes = changes_of(there, campaign.scene, case.values) if there else []
    noise: list[tuple[int, Change]]
    noise = [(tick, NumberChange("seed", seed)) for tick, seed in case.reseeds]
    changes = sorted(noise + changes, key=lambda one: one[0])
    seconds = min(case.seconds, scenario.seconds)
    last = max(1, ticks_of(seconds, campaign.scene.servo_period))
    return BoundCase(scenario, servo, changes, last)
