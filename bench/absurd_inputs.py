"""Inputs that no machine can take: huge, denormal, not a number."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

import numpy as np

from arm_emulator import Diverged, Plant, Refusal
from arm_emulator.machine.schemes.known import SCHEMES
from bench.hard_case import SHARED, Outcome, three_axis
from bench.motion import Array


def absurd_inputs(quick: bool) -> Iterator[Outcome]:
    """Huge is the supply, denormal is nothing, and what is no number changes nothing."""
    for scheme in SCHEMES:
        plant = Plant(three_axis(scheme, 1e-4, **SHARED))
        yield Outcome(scheme, 1e-4, float(_breaches(plant)), 0.0)


def _breaches(plant: Plant) -> int:
    """Return how many of the rules for absurd inputs a plant breaks."""
    start, zero = plant.scene.start, np.zeros(3)

    def moved(volts: float) -> Array:
        plant.reset()
        plant.advance(np.full(3, volts), 500)
        return plant.state.q

    wrong = [
        not np.array_equal(moved(1e300), moved(48.0)),
        not np.array_equal(moved(-1e300), moved(-48.0)),
        # Motion by a denormal voltage is lost in rounding beside angles of 1 rad.
        np.abs(moved(5e-324) - start).max() > 1e-15,
        np.abs(moved(-1e-310) - start).max() > 1e-15,
    ]
    for refused in (
        lambda: plant.advance([math.nan, 0.0, 0.0], 1),
        lambda: plant.advance([0.0, math.inf, 0.0], 1),
        lambda: plant.advance(zero, 2**63),
        lambda: plant.advance(zero, -1),
        lambda: plant.reset(q=[math.nan, 0.0, 0.0]),
        lambda: plant.reset(q=[1e300, 0.0, 0.0]),
        lambda: plant.reset(v=[math.inf, 0.0, 0.0]),
        lambda: plant.reset(v=[1e300, 0.0, 0.0]),
    ):
        wrong.append(not _refused(plant, refused))
    plant.reset(v=np.full(3, 1e6))  # a speed, if a mad one: no step can follow it
    try:
        plant.advance(zero, 1)
        wrong.append(True)
    except Diverged:
        wrong.append(plant.t != 0.0 or not np.array_equal(plant.state.q, start))
    plant.reset(v=np.full(3, 1e-310))
    plant.advance(zero, 500)
    wrong.append(np.abs(plant.state.q - start).max() > 1e-15)
    return sum(map(bool, wrong))


def _refused(plant: Plant, action: Callable[[], object]) -> bool:
    """Whether the plant refuses and stays as it was."""
    before = dataclasses.astuple(plant.state)
    try:
        action()
    except Refusal:
        after = dataclasses.astuple(plant.state)
        return all(np.array_equal(one, two) for one, two in zip(before, after, strict=True))
    return False
