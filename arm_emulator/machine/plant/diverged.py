"""The end of a motion that can no longer be integrated."""

import copyreg
from typing import Any

from arm_emulator.base.arrays import Array
from arm_emulator.machine.scene.scene import Scene


class Diverged(RuntimeError):
    """The integration left the physical range; the plant stays at the last sound state.

    Its text states joint and time. `analysis.stability.explain` adds why.

    Attributes:
        joint: the joint that left first, or that held the most of an energy from nowhere.
        t: logical time of the last state within bounds [s].
        scene: the machine.
        q: its link positions then (N,) [rad or m].
        v: its link speeds then (N,) [rad/s or m/s].
        applied: to the motors then (N,) [V, N m, A].
        hint: why, in words, where somebody has found it out; part of the text.
    """

    def __init__(
        self,
        joint: str,
        t: float,
        scene: Scene,
        q: Array,
        v: Array,
        applied: Array,
    ) -> None:
        self.joint, self.t, self.scene = joint, t, scene
        self.q, self.v, self.applied = q, v, applied
        self.hint = ""
        super().__init__(
            f"Plant.advance: joint {joint} diverged after t = {t:.6g} s with scheme "
            f"{scene.integrator.scheme} at dt = {scene.integrator.dt:g} s; the plant stays at the "
            "last state before"
        )

    def __str__(self) -> str:
        return super().__str__() + (f"; {self.hint}" if self.hint else "")

    def __reduce__(self) -> tuple[Any, ...]:
        # As it stands: a worker process hands it over, and `args` are not those of `__init__`.
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]
