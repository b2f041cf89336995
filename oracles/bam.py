"""Friction budget of M. Duclusaud and G. Passault, written down from its source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Bam:
    """Model M6 of arXiv 2410.08650, by its symbols [SI]."""

    Kc: float
    Kcs: float
    Km: float
    Ke: float
    Kms: float
    Kes: float
    Kmq: float
    Keq: float
    speed: float
    alpha: float

    def __call__(self, sign: float, w: float, A: float, S: float, leads: bool) -> float:
        """Return the torque against a shaft that turns at w [N m].

        Args:
            sign: direction of the shaft, on which it does not depend.
            w: speed of the shaft [rad/s].
            A: torque of the motor [N m].
            S: torque that the gear takes, the external torque's opposite [N m].
            leads: whether A counts as the greater one.
        """
        tm, te = A, -S
        share = float(np.exp(-(abs(w / self.speed) ** self.alpha)))
        quadratic = (self.Keq * te**2 if leads else self.Kmq * tm**2) if tm * te < 0.0 else 0.0
        at_rest = self.Kcs + abs(self.Kes * te - self.Kms * tm) + quadratic
        return float(self.Kc + abs(self.Ke * te - self.Km * tm) + share * at_rest)

    def make_section(self, viscous: float) -> dict[str, float]:
        """Return the section of the scene, at the same shaft."""
        return {
            "viscous": viscous, "coulomb": self.Kc, "breakaway": self.Kc + self.Kcs,
            "stribeck": self.speed, "exponent": self.alpha,
            "load": self.Ke, "motor_load": self.Km,
            "rest_load": self.Kes, "rest_motor_load": self.Kms,
            "rest_load_square": self.Keq, "rest_motor_square": self.Kmq,
        }  # fmt: skip
