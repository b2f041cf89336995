"""Frequency responses of a machine: from the command of a joint to the speeds of motor and link."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

from arm_emulator.analysis.linearised import LinearMachine
from arm_emulator.machine.chain import Array

ComplexArray = npt.NDArray[np.complex128]
PROMINENCE = 1.0  # dB, of a peak or a dip beside what surrounds it


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Speeds per unit of one joint's command, the other commands held.

    Attributes:
        frequency: (K,) [Hz].
        motor: of the motor [rad/s per V, N m or A], complex (K,).
        link: of the link [rad/s or m/s per V, N m or A], complex (K,).
    """

    frequency: Array
    motor: ComplexArray
    link: ComplexArray

    @property
    def resonances(self) -> Array:
        """Frequencies at which the motor moves more than beside them [Hz]."""
        return self._peaks(1.0)

    @property
    def antiresonances(self) -> Array:
        """Frequencies at which the links hold the motor [Hz]."""
        return self._peaks(-1.0)

    def _peaks(self, sign: float) -> Array:
        decibels = sign * 20.0 * np.log10(np.abs(self.motor))
        at, _ = signal.find_peaks(decibels, prominence=PROMINENCE)
        found: Array = self.frequency[at]
        return found


def frequency_response(machine: LinearMachine, joint: int, frequency: Array) -> FrequencyResponse:
    """Return the response to the command of a joint, at frequencies (K,) [Hz], above 0."""
    A, B = machine.A, machine.B[:, [joint]]
    s: ComplexArray = (2j * np.pi * frequency).astype(np.complex128)
    x = np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B)[..., 0].astype(np.complex128)
    angle: ComplexArray = x @ machine.theta_m[joint] + machine.theta_m_by_u[joint, joint]
    return FrequencyResponse(frequency, s * angle, x[:, machine.v.start + joint])
