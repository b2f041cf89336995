"""A servo of one joint against a motor that is integrated exactly."""

import math
from pathlib import Path

import numpy as np
import scipy.linalg

from arm_emulator.servo.servo import JointServo

CONFIG = Path(__file__).resolve().parents[2] / "config"

PERIOD = 1e-3

JOINT = JointServo(
    name="joint",
    gear_ratio=0.01,
    counts_per_turn=1024,
    resistance=1.0,
    inductance=1e-3,
    torque_constant=0.05,
    back_emf_constant=0.05,
    rotor_inertia=1e-4,
    current_limit=20.0,
    voltage_limit=100.0,  # more than there is
    velocity_limit=3.0,
    position_gain=30.0,
    velocity_gain=150.0,
    integral_time=0.2,
    observer_bandwidth=300.0,
)


class Drivetrain:
    """Motor, elastic gear and link of one joint; exact for voltages and torques held over a period.

    Written from eq. (1), (2) and (4) of the paper: L di/dt = V - R i - Kb wm and so on, as one
    linear system whose transition matrix is a matrix exponential.
    """

    def __init__(
        self,
        joint: JointServo,
        link_inertia: float = 0.4,
        stiffness: float = 1e4,
        damping: float = 10.0,
        viscous: float = 0.5,
        load: float = 0.0,
        q: float = 0.0,
    ) -> None:
        R, Kt = joint.resistance, joint.torque_constant
        L = joint.inductance or 1e-6 * R * PERIOD  # as good as at once
        Kb, Mm, Ng = joint.back_emf_constant, joint.rotor_inertia, joint.gear_ratio
        Kg, Dg, J = stiffness, damping, link_inertia
        A = np.zeros((7, 7))  # current, theta_m, omega_m, q, v; held: voltage, load
        A[0, [0, 2, 5]] = -R / L, -Kb / L, 1 / L
        A[1, 2] = 1.0
        A[2, :5] = Kt / Mm, -Ng * Ng * Kg / Mm, -Ng * Ng * Dg / Mm, Ng * Kg / Mm, Ng * Dg / Mm
        A[3, 4] = 1.0
        A[4, 1:5] = Ng * Kg / J, Ng * Dg / J, -Kg / J, -(Dg + viscous) / J
        A[4, 6] = 1 / J
        self._transition = scipy.linalg.expm(A * PERIOD)
        self._counts_per_rad = joint.counts_per_turn / (2 * math.pi)
        self.Ng = Ng
        self.x = np.array([0.0, q / Ng, 0.0, q, 0.0, 0.0, load])

    @property
    def counts(self) -> int:
        return math.floor(self.x[1] * self._counts_per_rad)

    @property
    def q_motor(self) -> float:
        return float(self.x[1] * self.Ng)

    def advance(self, voltage: float) -> None:
        self.x[5] = voltage
        self.x = self._transition @ self.x
