"""Runs of a campaign as the arms of a fleet get them: arrays over all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.extension.base import Array
from arm_emulator.extension.runs import ServoConfig
from arm_emulator_campaign.definition.campaign import Campaign
from arm_emulator_campaign.definition.drawn_scenarios import draw_scenarios
from arm_emulator_campaign.definition.scenario import count_all_ticks
from arm_emulator_campaign.judging.program import Targets
from arm_emulator_campaign.simulation.case import Cases
from arm_emulator_campaign.simulation.change_rows import ChangeRows, make_change_rows


@dataclass(frozen=True)
class BoundCases:
    """Runs with all that they draw in their file.

    Attributes:
        numbers: of the scene that vary (K, P), in its order.
        start: joint positions at the start of each, or one row of all (., N) [rad or m].
        targets: of each; None: those of the nominal scenario.
        servos: of each, or one of all.
        changes: what faults and forks set.
        last: tick at which each ends (K,).
    """

    numbers: Array
    start: Array
    targets: Targets | None
    servos: Sequence[ServoConfig]
    changes: ChangeRows
    last: NDArray[np.int64]


def bind_cases(campaign: Campaign, cases: Cases) -> BoundCases:
    """Return runs of a campaign, one at least, as the arms of a fleet get them.

    Each is bound as `bind_case` binds it alone.

    Raises:
        Refusal: a drawn value that is out of range.
    """
    scene, count = campaign.scene, len(cases)
    values = dict(zip(cases.names, cases.values.T, strict=True))
    own = np.array([number.value for number in scene.varied], np.float64)
    numbers = np.tile(own, (count, 1))
    for place, varied in enumerate(scene.varied):
        if varied.name in values:
            varied.number.check_values(campaign.where, values[varied.name])
            numbers[:, place] = values[varied.name]
    faults = campaign.bind_faults(values)
    there = [fault for name, fault in faults.items() if name not in cases.without]
    changes = make_change_rows(there, cases.reseeds, scene, numbers)
    if scene.has_sensor_errors and "seed" not in values:
        place = [varied.name for varied in scene.varied].index("seed")
        numbers[:, place] = cases.seeds  # behind the faults, whose end sets the scene's own
    start, targets, seconds = _bind_scenarios(campaign, values)
    last = count_all_ticks(np.minimum(cases.seconds, seconds), scene.servo_period)
    return BoundCases(
        numbers,
        start,
        targets,
        campaign.bind_servos(cases.names, cases.values),
        changes,
        np.broadcast_to(np.maximum(1, last), (count,)),
    )


def _bind_scenarios(
    campaign: Campaign, values: Mapping[str, Array]
) -> tuple[Array, Targets | None, ArrayLike]:
    """Return start and targets of each run, and its seconds, or those of all."""
    nominal, period = campaign.nominal[0], campaign.scene.servo_period
    if not any(name.split(".")[0] == "scenario" for name in values):
        return nominal.start[None], None, nominal.seconds
    scenarios = draw_scenarios(
        nominal, campaign.data["scenario"], campaign.scene, values, campaign.where
    )
    # The start is the target until the first one.
    t = np.pad(scenarios.t, ((0, 0), (1, 0)))
    q = np.concatenate([scenarios.start[:, None], scenarios.q], axis=1)
    holds = np.ones(t.shape, bool)
    holds[:, 0] = scenarios.t[:, 0] > 0.0 if scenarios.t.size else True
    first = np.concatenate([[0], np.cumsum(np.count_nonzero(holds, axis=1))])
    return (
        scenarios.start,
        Targets(count_all_ticks(t, period)[holds], q[holds], first),
        scenarios.seconds,
    )
