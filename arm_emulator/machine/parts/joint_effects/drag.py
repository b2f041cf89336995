"""Drag of links in water or air."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.fault import Fault, bound_rise, declare_rise
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@register_part
class Drag(JointEffect):
    """A torque against the motion of the link that grows with the square of its speed."""

    section = "drag"
    header = "joint_effects/drag.hpp"
    cxx = "Drag"

    coefficient: float = number(
        "c",
        "N m s2/rad2",
        at_least=0.0,
        prior="unknown",
        text="c; of a part of the area A at the distance r: about 0.5 rho cd A r^3",
    )

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "drag_grows",
                "something that drags has been caught at the link",
                sets=declare_rise("drag.coefficient"),
                magnitude=bound_rise("N m s2/rad2", 1.0, 1e6),
            ),
        )

    def compute_effort(self, motion: ShaftMotion) -> Array:  # noqa: D102
        torque: Array = self.coefficient * np.abs(motion.speed) * motion.speed
        return torque
