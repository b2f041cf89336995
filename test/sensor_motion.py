"""Readings of a sensor beside the truth, while a machine is moved at random."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from arm_emulator.machine.plant import Plant


def readings_and_truth(
    plant: Plant, read: Callable[[Plant], tuple[np.ndarray, np.ndarray]], ticks: int, volts: float,
    seed: int,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Move a plant with commands that change each 100 ticks; return both, a row per tick.

    Args:
        plant: at its start, which is the first row.
        read: returns readings and truth of a plant.
        ticks: how many follow.
        volts: largest command.
        seed: of the commands.
    """
    rng = np.random.default_rng(seed)
    rows = [read(plant)]
    for tick in range(ticks):
        if tick % 100 == 0:
            command = rng.uniform(-volts, volts, 3)
        plant.exchange(command)
        rows.append(read(plant))
    shown, true = zip(*rows, strict=True)
    return np.array(shown), np.array(true)
