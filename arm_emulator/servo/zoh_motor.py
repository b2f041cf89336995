"""A motor over one servo period: voltage and load held, winding and rotor exact.

Over a period T in which voltage V and load torque do not change, eq. (1) and (2) of the paper,

    L di/dt = V - R i - Kb omega        Mm domega/dt = Kt i - load        dtheta/dt = omega

are linear, so that current, speed and angle at its end are known sums of those at its start. They
depend on two ratios only: T to the motor's time constant R Mm / (Kt Kb), and the winding's time
constant L / R to T. They hold for every value of both: a motor may be much faster than the period.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.products import multiply_matrices


class Sum(NamedTuple):
    """A quantity of a period as a sum over current, speed, voltage and load at its start."""

    current: float
    speed: float
    voltage: float
    load: float


@dataclass(frozen=True)
class ZohMotor:
    """Response of a motor over one period; quantities in SI units, all at the motor.

    A current that differs from its prediction has two possible causes: another voltage (or another
    resistance, back EMF or limit of the drive), or another load. Both are taken to be off by
    currents of equal size; what the voltage then explains has moved the rotor, the load is left to
    the encoder. Where the motor is slow (T far below its time constant) the voltage explains all,
    so that the torque is that of the measured currents; where it is fast, the current at the end
    has the load alone, and the speed comes from the voltage.
    """

    current: Sum
    """At the end of the period [A]."""
    speed: Sum
    """At the end of the period [rad/s]."""
    turn: Sum
    """Angle turned in the period [rad]."""
    speed_per_surplus: float
    """Speed per current above its prediction [rad/s/A]."""
    turn_per_surplus: float
    """Angle per current above its prediction [rad/A]."""
    voltage_per_surplus: float
    """Voltage per current above its prediction [V/A]."""


@lru_cache(1024)
def compute_zoh_motor(
    resistance: float,
    inductance: float,
    torque_constant: float,
    back_emf_constant: float,
    rotor_inertia: float,
    period: float,
) -> ZohMotor:
    """Return what a motor does in one period; units as in `JointServo`.

    Raises:
        ArithmeticError: numbers so far apart that something overflows.
    """
    # In currents and periods: v = V / R, l = load / Kt, w = omega / g, turn / (g T), s = t / T:
    #   y di/ds = v - i - x w    dw/ds = i - l    dturn/ds = w
    g = torque_constant * period / rotor_inertia
    x = back_emf_constant * g / resistance
    y = inductance / resistance / period
    rows = _integrate_period(x, y)  # i, w, turn by i, w, v, l
    i_v, i_l = rows[0, 2:].tolist()
    size = math.hypot(i_v, i_l)
    if size == 0.0:
        raise ZeroDivisionError("neither voltage nor load moves the current")
    to_si = np.array([1.0, g, g * period])[:, None]
    from_si = np.array([1.0, 1.0 / g, 1.0 / resistance, 1.0 / torque_constant])
    with np.errstate(over="ignore", invalid="ignore"):
        volts = i_v / size / size
        moved = rows[1:, 2:3] * volts * to_si[1:]
        current, speed, turn = (Sum(*row) for row in (to_si * rows * from_si).tolist())
    by_speed, by_turn = moved[:, 0].tolist()
    return ZohMotor(current, speed, turn, by_speed, by_turn, resistance * volts)


_AT_ONCE = 1e-6  # of a period: a winding that is faster than this is taken as one at once


def _integrate_period(x: float, y: float) -> Array:
    """Return current, speed and turn (3,) after a period by current, speed, voltage, load (4,)."""
    # Held quantities are states that do not change.
    if y < _AT_ONCE:  # i = v - x w, also before
        A = np.zeros((4, 4))  # w, turn, v, l
        A[0] = -x, 0.0, 1.0, -1.0
        A[1, 0] = 1.0
        (w_w, _, w_v, w_l), (t_w, _, t_v, t_l) = compute_exponential(A)[:2].tolist()
        return np.array(
            [
                [0.0, -x * w_w, 1.0 - x * w_v, -x * w_l],
                [0.0, w_w, w_v, w_l],
                [0.0, t_w, t_v, t_l],
            ]
        )
    A = np.zeros((5, 5))  # i, w, turn, v, l
    A[0] = -1.0 / y, -x / y, 0.0, 1.0 / y, 0.0
    A[1, [0, 4]] = 1.0, -1.0
    A[2, 1] = 1.0
    return compute_exponential(A)[:3, [0, 1, 3, 4]]


_TERMS = 14  # of the series; of a matrix of size 1/2 the rest is below 1e-16


def discretise_zoh(A: Array, B: Array, period: float) -> tuple[Array, Array]:
    """Return F and G such that dx/dt = A x + B u, u held, leads to x(T) = F x(0) + G u.

    Args:
        A: (n, n) [1/s].
        B: (n, m).
        period: T [s].
    """
    n, m = B.shape
    matrix = np.zeros((n + m, n + m))
    matrix[:n, :n], matrix[:n, n:] = A, B
    out = compute_exponential(matrix * period)
    return out[:n, :n], out[:n, n:]


def compute_exponential(A: Array) -> Array:
    """Return exp(A): a series of A / 2**n, and n squarings (Moler and Van Loan 2003, method 3).

    Raises:
        OverflowError: it has numbers beyond those of a computer.
    """
    with np.errstate(all="ignore"):
        out = _sum_series(A)
    if not np.isfinite(out).all():
        raise OverflowError("the exponential of a matrix is too large")
    return out


def _sum_series(A: Array) -> Array:
    size = float(np.abs(A).sum(axis=1).max())
    squarings = max(0, int(np.frexp(size)[1]) + 1)
    step = A / 2.0**squarings
    term = out = np.eye(len(A))
    for k in range(1, _TERMS):
        term = multiply_matrices(term, step) / k
        out = out + term
    for _ in range(squarings):
        out = multiply_matrices(out, out)
    return out
