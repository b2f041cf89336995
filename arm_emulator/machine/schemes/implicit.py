"""Implicit Euler of drives and links."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.registry import register_scheme
from arm_emulator.machine.schemes.scheme import Scheme


@register_scheme
class Implicit(Scheme):
    """Its error damps."""

    name = "implicit"
    order = 1
    evaluations = 1
    text = "first order, stable with stiff drives"

    @staticmethod
    def build_step_matrix(J: Array, A: Array, motors: int, dt: float) -> Array:  # noqa: D102
        unit = np.eye(len(J))
        step: Array = unit + dt * np.linalg.solve(unit - dt * A, J)
        return step
