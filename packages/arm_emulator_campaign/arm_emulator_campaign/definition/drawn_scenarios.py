"""Scenarios of many runs whose numbers vary, in arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from arm_emulator.extension.base import POSITION, Array, Number, Refusal
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.runs import keep_limits
from arm_emulator_campaign.definition.scenario import AT, SECONDS, Scenario


@dataclass(frozen=True)
class DrawnScenarios:
    """Scenarios with joint targets, of K runs.

    Attributes:
        seconds: duration (K,) [s].
        start: joint positions (K, N) [rad or m].
        t: times of the targets (K, T) [s].
        q: targets (K, T, N) [rad or m].
    """

    seconds: Array
    start: Array
    t: Array
    q: Array


def draw_scenarios(
    nominal: Scenario,
    section: Mapping[str, Any],
    scene: Scene,
    values: Mapping[str, Array],
    where: str,
) -> DrawnScenarios:
    """Return the scenarios of runs, each as `read_scenario` reads it with its numbers.

    Args:
        nominal: where nothing varies.
        section: of the campaign's file.
        scene: the machine.
        values: of what varies, one at least, an array of all runs for each (K,).
        where: for refusals.

    Raises:
        Refusal: a value that is out of its range.
    """
    count = len(next(iter(values.values())))

    def take_samples(name: str, bound: Number, otherwise: float) -> Array:
        samples = values.get(f"scenario.{name}")
        if samples is None:
            return np.full(count, otherwise)
        bound.rename(f"scenario.{name}").check_values(where, samples)
        return samples

    joints = scene.joint_names
    start = np.stack(
        [
            take_samples(f"start.{joint}", POSITION, q)
            for joint, q in zip(joints, nominal.start, strict=True)
        ],
        axis=1,
    )
    seconds = take_samples("seconds", SECONDS, nominal.seconds)
    table = nominal.targets
    if table is None:
        return DrawnScenarios(
            seconds, start, np.empty((count, 0)), np.empty((count, 0, len(joints)))
        )
    t = np.broadcast_to(table.t, (count, *table.t.shape))
    q = np.broadcast_to(table.q, (count, *table.q.shape))
    entries = section.get("targets") or ()
    if entries:
        t, q, before = t.copy(), q.copy(), start
        for row, entry in enumerate(entries):
            t[:, row] = take_samples(f"targets.{row}.at", AT, table.t[row])
            for place, joint in enumerate(joints):
                name, otherwise = f"targets.{row}.{joint}", table.q[row, place]
                stated = joint in entry
                q[:, row, place] = (
                    take_samples(name, POSITION, otherwise) if stated else before[:, place]
                )
            before = q[:, row]
        if not np.all(t[:, 1:] > t[:, :-1]):
            raise Refusal(where, "scenario.targets", "have ascending times", "others")
        if not keep_limits(scene, t, q):
            raise Refusal(where, "scenario.targets", "keep the limits of the joints", "others")
    return DrawnScenarios(seconds, start, t, q)
