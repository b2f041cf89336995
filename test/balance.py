"""The balance of energy of a machine over a run."""

from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.plant import Plant


@dataclass(frozen=True)
class Balance:
    """Of the machine, and of each joint (N,) what it dissipated."""

    left: float  # J, gained and neither given nor dissipated: 0 but for the scheme's error
    given: float  # J, by the supply; what came back is taken off
    dissipated: Array  # J
    exchanged: float  # J, that went either way: given, taken back and dissipated


def balance_of(plant: Plant, rows: Array, steps: int) -> Balance:
    """Advance a machine by rows of commands (K, N), so many steps each."""
    before, supplied, dissipated, exchanged = plant.energy, 0.0, np.zeros(rows.shape[1]), 0.0
    for row in rows:
        flow = plant.advance_metered(row, steps)
        supplied += float(flow.supplied.sum())
        dissipated += flow.dissipated
        exchanged += float(np.abs(flow.supplied).sum() + flow.dissipated.sum())
    left = plant.energy - before - supplied + float(dissipated.sum())
    return Balance(abs(left), supplied, dissipated, exchanged)
