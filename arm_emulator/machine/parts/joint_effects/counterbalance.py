"""Springs that balance the weight of an arm."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.fault import Fault, bound_share, declare_fall
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@register_part
class Counterbalance(JointEffect):
    """A spring between the link and its parent, by its geometry; a negative force pulls."""

    section = "counterbalance"
    rank = 0
    of_angle = True
    header = "joint_effects/counterbalance.hpp"
    cxx = "Counterbalance"

    base_distance: float = number("a", "m", above=0.0, at_most=100.0, varied=False, text="a")
    link_distance: float = number(
        "b",
        "m",
        above=0.0,
        at_most=100.0,
        varied=False,
        text="b; differs from a by 1 % of it or more",
    )
    angle: float = number(
        "phi",
        "rad",
        ends=(-1e4, 1e4),
        default=0.0,
        text="phi: the joint angle at which the spring is shortest",
    )
    force: float = number(
        "F0",
        "N",
        ends=(-1e7, 1e7),
        prior="known",
        text="F0, at the length `length`; > 0 pushes, < 0 pulls",
    )
    length: float = number("l0", "m", above=0.0, at_most=200.0, text="l0")
    stiffness: float = number(
        "k",
        "N/m",
        at_least=0.0,
        prior="known",
        default=0.0,
        text="k: growth of the force per metre of compression",
    )
    gas_column: float = number(
        "h",
        "m",
        at_least=0.0,
        varied=False,
        default=0.0,
        text="h; 0: a straight line. Else 1.01 of the way by which the gas is "
        "compressed beyond `length`, or more, and no `stiffness`",
    )

    def compute_effort(self, motion: ShaftMotion) -> Array:  # noqa: D102
        a, b, at = self.base_distance, self.link_distance, motion.angle - self.angle
        l = np.sqrt(a * a + b * b - 2.0 * a * b * np.cos(at))  # noqa: E741
        longer = l - self.length
        if h := self.gas_column:
            F = self.force * h / (h + np.copysign(1.0, self.force) * longer)
        else:
            F = self.force - self.stiffness * longer
        torque: Array = -F * a * b * np.sin(at) / l
        return torque

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "counterbalance_weakens",
                "the counterbalance loses a share of its force",
                sets=declare_fall("counterbalance.force", "counterbalance.stiffness"),
                magnitude=bound_share(0.5),
            ),
        )

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        smallest = 0.01 * self.base_distance
        if abs(self.link_distance - self.base_distance) < smallest:
            rule = f"differ by {smallest:g} m from base_distance, so that the spring keeps a length"
            raise section.make_refusal("link_distance", rule, self.link_distance)
        if not self.gas_column:
            return
        if self.stiffness:
            rule = "be absent with gas_column, which has a progression of its own"
            raise section.make_refusal("stiffness", rule, self.stiffness)
        shortest = abs(self.base_distance - self.link_distance)
        longest = self.base_distance + self.link_distance
        # Largest compression of the gas beyond `length`.
        stroke = longest - self.length if self.force < 0.0 else self.length - shortest
        if self.gas_column < 1.01 * stroke:
            rule = f"be >= {1.01 * stroke:g} m, so that some gas is left wherever the link is"
            raise section.make_refusal("gas_column", rule, self.gas_column)
