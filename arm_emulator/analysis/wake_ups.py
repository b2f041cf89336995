"""Lateness of the real-time thread on this machine, with a scene's work in each period."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from arm_emulator.machine.plant import Plant
from arm_emulator.machine.real_time import RealTimeLoop
from arm_emulator.machine.scene import Scene

QUANTILES = (0.5, 0.99, 0.999, 1.0)


@dataclass(frozen=True)
class WakeUps:
    """Wake-ups at the ends of periods.

    Attributes:
        period: between them [s].
        late: by how much each was late [s].
        spent: on each period's steps [s].
        lost: periods that were over before their wake-up.
        fifo: whether the thread ran under SCHED_FIFO.
    """

    period: float
    late: NDArray[np.float64]
    spent: NDArray[np.float64]
    lost: int
    fifo: bool

    @property
    def quantiles(self) -> list[float]:
        """Lateness at `QUANTILES` [s]."""
        return [float(np.quantile(self.late, part, method="higher")) for part in QUANTILES]


def wake_ups(scene: Scene, period: float, seconds: float) -> WakeUps:
    """Run the real-time loop of a scene, its motors at 0.

    Args:
        scene: the machine, of which each period computes the steps of one servo period.
        period: wall time between wake-ups [s].
        seconds: how long [s].

    Raises:
        Refusal: see `RealTimeLoop`.
    """
    plant = Plant(scene)
    loop = RealTimeLoop(plant, round(period * 1e9), scene.cores[0])
    late, spent = [], []
    loop.start(0)
    until = time.monotonic() + seconds
    try:
        while time.monotonic() < until:
            loop.wait(0.1)
            while (reached := loop.take()) is not None:
                late.append(reached.lateness)
                spent.append(reached.spent)
    finally:
        loop.stop()
    figures = loop.figures
    late_s, spent_s = (np.array(one, np.float64) * 1e-9 for one in (late, spent))
    return WakeUps(period, late_s, spent_s, figures.lost_periods, bool(figures.fifo))
