"""The paper's scheme: backward Euler of the motors, then forward Euler of the links."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.registry import register_scheme
from arm_emulator.machine.schemes.scheme import Scheme


@register_scheme
class Paper(Scheme):
    """The motors step with the links held."""

    name = "paper"
    header = "paper.hpp"
    order = 1
    evaluations = 1
    text = "the paper's, first order"

    @staticmethod
    def build_step_matrix(J: Array, A: Array, motors: int, dt: float) -> Array:  # noqa: D102
        m = motors
        of_motors, of_links = np.eye(len(J)), np.eye(len(J))
        of_motors[:m] = np.linalg.solve(
            np.eye(m) - dt * A[:m, :m], np.hstack([np.eye(m), dt * A[:m, m:]])
        )
        of_links[m:] += dt * J[m:]
        return of_links @ of_motors
