"""A synchronous motor without one of its phases, in C++.

Its other two carry what they carried, their star point being connected. Of the torque
``k iq 2/3 sum sin^2(p tm - 2 pi j / 3)`` over three phases is left
``k iq (1 - 2/3 sin^2 p tm) = k iq 2/3 (1 + cos(2 p tm) / 2)``, and of the induced voltage the same
share: a smaller flux with a ripple.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.decorator import CxxMotor, Decorator
from arm_emulator.machine.parts.motor import Motor
from arm_emulator.machine.parts.pmsm import Pmsm
from arm_emulator.machine.parts.torque_ripple import TorqueRipple


def has_phases(motor: Motor | None, decorators: Iterable[Decorator]) -> bool:
    """Return whether a motor has phases of which one can be lost."""
    rippled = any(isinstance(one, TorqueRipple) for one in decorators)
    return isinstance(motor, Pmsm) and not rippled


def without_a_phase(inner: CxxMotor, motor: Motor | None, lost: str) -> CxxMotor:
    """Return the motor with the ripple of a lost phase; `lost` is the share of it, in C++."""
    assert isinstance(motor, Pmsm), "see phases"
    kind = f"arm::RippledMotor<{inner.type}, 1>"
    order, quarter = (cxx_literals.number(x) for x in (2.0 * motor.pole_pairs, 0.5 * math.pi))
    wave = f"{{{order}, {lost} / (3.0 - {lost}), {quarter}}}"
    return CxxMotor(kind, f"{kind}{{{inner.value}, {{{{{wave}}}}}}}")
