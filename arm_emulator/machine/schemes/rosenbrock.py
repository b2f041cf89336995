"""The Rosenbrock method ROS2, a W-method."""

import math

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.registry import register_scheme
from arm_emulator.machine.schemes.scheme import Scheme

GAMMA = 1.0 - math.sqrt(0.5)


@register_scheme
class Rosenbrock(Scheme):
    """The Rosenbrock method; both of its stages evaluate the links."""

    name = "rosenbrock"
    order = 2
    evaluations = 2
    locates = True
    text = "second order"
    default = True

    @staticmethod
    def build_step_matrix(J: Array, A: Array, motors: int, dt: float) -> Array:  # noqa: D102
        unit = np.eye(len(J))
        W = unit - GAMMA * dt * A
        k1 = np.linalg.solve(W, J)
        k2 = np.linalg.solve(W, J @ (unit + dt * k1) - 2.0 * k1)
        step: Array = unit + dt * (1.5 * k1 + 0.5 * k2)
        return step
