"""Friction by bristles that bend before they slip."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.fault import Fault, bound_rise, declare_rise
from arm_emulator.machine.parts.frictions.stribeck import compute_stribeck_torque
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


class LuGre(JointEffect):
    """Bristle friction, for motion before sliding: positioning, reversals, stick-slip."""

    header = "frictions/lugre.hpp"
    cxx = "LuGre"

    coulomb: float = number("Dc", "N m", above=0.0, prior="unknown", text="Dc, sliding fast")
    breakaway: float = number(
        "Ds", "N m", follows="coulomb", default=0.0, text="Ds, sliding slowly"
    )
    stribeck: float = number("vs", "rad/s", above=0.0, default=0.1, text="vs")
    bristle_stiffness: float = number(
        "s0", "N m/rad", above=0.0, text="s0; the shaft yields by Ds / s0 at most before it slides"
    )
    bristle_damping: float = number(
        "s1",
        "N m s/rad",
        at_least=0.0,
        default=0.0,
        text="s1; √(s0 times the inertia that moves) damps its swing on the bristles",
    )

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """Bend the bristles along the motion, from straight ones."""
        w = motion.speed
        g = compute_stribeck_torque(self.coulomb, self.breakaway, self.stribeck, w)
        rate = self.bristle_stiffness * np.abs(w) / g  # 1/s, at which they let go
        decay = np.exp(-np.gradient(motion.t) * rate)
        # Limit for bristles that slip at once.
        end = np.sign(w) * g / self.bristle_stiffness
        step = np.where(rate > 0.0, (1.0 - decay) * end, 0.0)
        z = np.empty_like(w)
        bent = 0.0
        for k, (share, more) in enumerate(zip(decay.tolist(), step.tolist(), strict=True)):
            bent = share * bent + more
            z[k] = bent
        torque: Array = self.bristle_stiffness * z + self.bristle_damping * (w - rate * z)
        return torque

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "seal_grips",
                "friction of bristles rises",
                sets=declare_rise("lugre.coulomb", "motor.lugre.coulomb"),
                magnitude=bound_rise("N m", 1.0, 1e6),
            ),
        )

    @property
    def cxx_type(self) -> str:  # noqa: D102
        return f"arm::{self.cxx}<arm::Place::{self.shaft}>"


@register_part
class LinkLuGre(LuGre):
    """Friction of a link by bristles that bend before they slip."""

    section = "lugre"
    rank = 2
    shaft = "link"


@register_part
class RotorLuGre(LuGre):
    """Friction of a rotor by bristles that bend before they slip."""

    section = "motor.lugre"
    rank = 3
    shaft = "rotor"
