"""A session in real time: a compiled thread owns the clock."""

from __future__ import annotations

from functools import partial

import numpy as np

from arm_emulator.machine.chain import Array
from arm_emulator.machine.clock import Clock, Reached, RealTimeFigures
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.real_time import RealTimeLoop
from arm_emulator.machine.scene import Scene
from arm_emulator.machine.session import Session


class LoopClock(Clock):
    """Ticks come from the real-time loop of the core, see `RealTimeLoop`.

    Attributes:
        loop: that loop.

    Args:
        plant: the machine.
        readers: of the loop.
    """

    by_itself = True

    def __init__(self, plant: Plant, readers: int = 1) -> None:
        scene = plant.scene
        period_ns = round(scene.servo_period * 1e9)
        super().__init__(plant)
        core, steps = scene.cores[0], scene.steps_per_period
        self.loop = RealTimeLoop(plant, period_ns, steps, core, readers)
        self._zero = np.zeros(len(scene.joints))
        self._spent_ns = 0  # on exchanges
        self.running = False

    @property
    def spent_ns(self) -> int:
        """Wall time that the exchanges of the ticks taken have needed so far [ns]."""
        return self._spent_ns

    @property
    def figures(self) -> RealTimeFigures:
        """Punctuality of the loop."""
        return self.loop.figures()

    def begin(self) -> None:
        """Restart at tick 0, see `Clock.begin`."""
        while self.loop.take() is not None:
            pass
        self.loop.command(-1, self._zero)
        self.loop.clear_figures()

    def command(self, answered: int, rows: Array) -> None:
        """Hold commands and further inputs (1 + I, N), which answer a tick, from now on."""
        self.loop.command(answered, rows[0], rows[1:])

    def start(self, tick: int) -> None:
        """Start time at a tick."""
        self.running = True
        self.loop.start(tick)

    def stop(self) -> None:
        """Stop within a period. Ticks not taken yet stay."""
        if self.running:
            self.loop.stop()
        self.running = False

    def go_on(self) -> None:
        """Continue as if time had not been stopped; missed deadlines are lateness."""
        self.running = True
        self.loop.go_on()

    def wait(self, timeout: float) -> bool:
        """Wait at most `timeout` [s] for a tick, without Python's lock."""
        return self.loop.wait(timeout)

    def take(self, *, newest: bool = False) -> Reached | None:
        """Return the oldest tick not taken yet, or the newest; None after the last."""
        reached = self.loop.take(newest=newest)
        if reached is not None:
            self._spent_ns += reached.spent
            if reached.fault >= 0:
                self.running = False  # the loop has ended there
        return reached


def real_time_session(
    scene: Scene, start: str, *, standing: bool = False, readers: int = 1
) -> Session:
    """Return a session whose ticks come from the real-time loop, see `Session`."""
    clock = partial(LoopClock, readers=readers)
    return Session(scene, "realtime", start, clock, standing=standing)
