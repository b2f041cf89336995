"""Base of all schemes: each declares what the others need to know of it.

A scheme is a class in a file of this package, called as the scheme, and registered there
(`register_scheme`). A header in `core/schemes/` has the C++ struct of that name.
"""

from typing import ClassVar

from arm_emulator.base.arrays import Array


class Scheme:
    """An integration method of the core. It is not instantiated."""

    name: ClassVar[str]  # `integrator.scheme` in the scene
    header: ClassVar[str] = "linearly_implicit.hpp"  # of the core that has it
    order: ClassVar[int]  # of the error between events
    evaluations: ClassVar[int]  # of the links in a step
    locates: ClassVar[bool] = False  # whether it may cut steps at events
    text: ClassVar[str]  # for people who choose
    default: ClassVar[bool] = False  # whether scenes have it that name no scheme

    @classmethod
    def write_cxx_type(cls) -> str:
        """Return its C++ type."""
        return f"arm::{cls.__name__}"

    @staticmethod
    def build_step_matrix(J: Array, A: Array, motors: int, dt: float) -> Array:
        """Return the matrix of one step of a small motion dx/dt = J x.

        Of x, or of x and x one step ago where the scheme takes that.

        Args:
            J: of the machine, (n, n); x begins with the states of the motors.
            A: the part of it that is stiff and cheap, drive by drive.
            motors: number of the motors' states.
            dt: step [s].
        """
        raise NotImplementedError
