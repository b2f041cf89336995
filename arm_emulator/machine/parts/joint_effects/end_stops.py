"""Stops at the ends of a joint's way."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.number import Number, build_bounds
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.fault import (
    Fault,
    bound_rise,
    bound_share,
    declare_fall,
    declare_rise,
)
from arm_emulator.machine.parts.joint_effects.joint_effect import JointEffect
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion

_BEYOND = Number(
    "beyond",
    "rad",
    default=0.0,
    text="distance of both stops from the limits, outwards; refused without `at`",
    **build_bounds((0.0, 1e4)),
)


@register_part
class EndStops(JointEffect):
    """A spring and a damper at each end that push the link back and never hold it."""

    section = "end_stops"
    rank = 1
    header = "joint_effects/end_stops.hpp"
    cxx = "EndStops"

    keys = (
        Key(
            "at",
            range="`limits`",
            absent="`lower` and `upper` are given",
            text="both ends at the URDF's limits of the joint",
        ),
        _BEYOND,
    )

    lower: float = number(
        "lower",
        "rad",
        ends=(-1e4, 1e4),
        text="q at which the lower stop is touched; refused together with `at`",
    )
    upper: float = number(
        "upper", "rad", ends=(-1e4, 1e4), text="q at which the upper stop is touched; above `lower`"
    )
    stiffness: float = number("K", "N m/rad", above=0.0, text="K, at the link")
    damping: float = number("D", "N m s/rad", at_least=0.0, default=0.0, text="D, at the link")

    def compute_effort(self, motion: ShaftMotion) -> Array:  # noqa: D102
        q, v = motion.angle, motion.speed
        K, D = self.stiffness, self.damping
        above = np.where(q > self.upper, np.maximum(K * (q - self.upper) + D * v, 0.0), 0.0)
        below = np.where(q < self.lower, np.maximum(K * (self.lower - q) - D * v, 0.0), 0.0)
        torque: Array = above - below
        return torque

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "stop_softens",
                "the end stops' stiffness falls",
                sets=declare_fall("end_stops.stiffness"),
                magnitude=bound_share(0.9, 0.999),
            ),
            Fault(
                "stop_moves",
                "the end stops turn on their shaft",
                sets=declare_rise("end_stops.lower", "end_stops.upper"),
                magnitude=bound_rise("rad", 0.1, 10.0, signed=True),
            ),
        )

    @property
    def stops(self) -> tuple[float, float]:  # noqa: D102
        return self.lower, self.upper

    @classmethod
    def put_limits(cls, section: Section, limits: tuple[float, float] | None) -> None:
        """Put the ends of its way where the section has `at: limits`."""
        beyond = section.read_number(_BEYOND)
        if not section.has_key("at"):
            if section.has_key(_BEYOND.name):
                raise section.make_refusal(
                    _BEYOND.name, "be given together with `at: limits`", beyond
                )
            return
        section.read_choice("at", ("limits",), default="limits")
        lower, upper = limits or (0.0, 0.0)
        for key, value in ("lower", lower - beyond), ("upper", upper + beyond):
            if section.has_key(key):
                raise section.make_refusal(key, "be absent together with `at: limits`", "both")
            section.set_value(key, value)
        if limits is None:
            raise section.make_refusal(
                "at", "be absent: the URDF has no limits of this joint", "limits"
            )

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        if self.lower >= self.upper:
            rule = f"be > {self.lower:g} rad, the lower one"
            raise section.make_refusal("upper", rule, self.upper)
