"""The Rosenbrock method ROS2, its second stage with the links' change over the step before."""

import math

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.registry import register_scheme
from arm_emulator.machine.schemes.rosenbrock import GAMMA
from arm_emulator.machine.schemes.scheme import Scheme


@register_scheme
class Extrapolated(Scheme):
    """The first stage alone evaluates the links."""

    name = "extrapolated"
    order = 2
    evaluations = 1
    locates = True
    text = "second order and cheaper, for smooth motions"

    @staticmethod
    def build_step_matrix(J: Array, A: Array, motors: int, dt: float) -> Array:  # noqa: D102
        n = len(J)
        unit = np.eye(n)
        W = unit - GAMMA * dt * A
        k1 = np.linalg.solve(W, J)
        d = np.linalg.solve(W, J - A)  # what J - A has changed since the last step
        k2 = math.sqrt(2.0) * np.linalg.solve(W, k1) + d
        return np.block(
            [[unit + dt * (GAMMA * k1 + 0.5 * k2), -0.5 * dt * d], [unit, np.zeros((n, n))]]
        )
