"""Energy that the joints of a machine are given and that they dissipate."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.machine.chain import Array


@dataclass(frozen=True)
class EnergyFlow:
    """What each joint is given and what it dissipates, (N,): W now, J over a time.

    It is given by the supply, and by the external wrench as far as that turns this joint.
    A motor whose torque constant differs from its back-EMF constant is given the difference, too.
    """

    given: Array
    dissipated: Array  # in windings, gears and friction
