"""What test suites of users need: a machine of its own for each test, and what it must keep."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.machine.chain import Array
from arm_emulator.machine.measured import Measured
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene, load_scene

Law = Callable[[int, Measured], ArrayLike]


def plant_of(scene: Scene | str | Path, overrides: Mapping[str, Any] | None = None) -> Plant:
    """Return a new plant of a scene, by name or file with overrides as `load_scene` takes them.

    Raises:
        Refusal: as `load_scene` and `Plant`.
    """
    return Plant(scene if isinstance(scene, Scene) else load_scene(scene, overrides))


def drive(plant: Plant, law: Law, ticks: int) -> Array:
    """Drive a plant by a control law for so many servo periods.

    Args:
        plant: the machine.
        law: the commands (N,) that answer a tick, from the tick and what is measured at it.
        ticks: how many.

    Returns:
        True link positions after each period, (ticks, N) [rad or m].

    Raises:
        Refusal: commands that are not taken.
        Diverged: see `Plant.exchange`.
    """
    q = np.zeros((ticks, len(plant.scene.joints)))
    for tick in range(ticks):
        plant.exchange(np.asarray(law(tick, plant.measured)), tick)
        q[tick] = plant.state.q
    return q


def assert_settles(q: ArrayLike, target: ArrayLike, within: float, last: int) -> None:
    """Assert that a run ends at a target, and that it stays there.

    Args:
        q: positions, a row each [rad or m].
        target: where they shall be.
        within: how far off they may be [rad or m].
        last: rows at the end that must be there.

    Raises:
        AssertionError: which joint is how far off, and when.
    """
    off = np.abs(np.asarray(q)[-last:] - np.asarray(target))
    row, joint = np.unravel_index(int(np.argmax(off)), off.shape)
    worst = float(off[row, joint])
    assert worst <= within, (
        f"joint {joint} is {worst:.3g} off {last - int(row)} rows before the end, not {within:g}"
    )
