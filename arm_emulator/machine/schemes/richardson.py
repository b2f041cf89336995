"""Richardson's extrapolation of the Rosenbrock method ROS2."""

from __future__ import annotations

from arm_emulator.base.arrays import Array
from arm_emulator.machine.schemes.registry import register_scheme
from arm_emulator.machine.schemes.rosenbrock import Rosenbrock
from arm_emulator.machine.schemes.scheme import Scheme


@register_scheme
class Richardson(Scheme):
    """A step of ROS2 and two of half its length; the first of these shares its evaluation."""

    name = "richardson"
    order = 3
    evaluations = 5
    text = "third order, for small errors of smooth motions"

    @staticmethod
    def build_step_matrix(J: Array, A: Array, motors: int, dt: float) -> Array:  # noqa: D102
        half = Rosenbrock.build_step_matrix(J, A, motors, 0.5 * dt)
        twice = half @ half
        step: Array = twice + (twice - Rosenbrock.build_step_matrix(J, A, motors, dt)) / 3.0
        return step
