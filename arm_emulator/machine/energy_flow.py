"""Energy supplied to and dissipated by the joints of a machine."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.base.by_value import ByValue
from arm_emulator.machine.chain import Array


@dataclass(frozen=True, eq=False)
class EnergyFlow(ByValue):
    """Energy supplied to and dissipated by each joint, (N,): W now, J over a time.

    The supply and the share of the external wrench that turns this joint supply it.
    A motor with different torque and back-EMF constants gets the difference, too.
    """

    given: Array
    dissipated: Array  # in windings, gears and friction
