"""Friction that grows with the torque of the gear, and with that of the motor."""

from typing import Any

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.validation.number import Ends
from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.frictions.friction import Friction, LinkFriction, OfRotor
from arm_emulator.machine.parts.frictions.stribeck import compute_stribeck_torque
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion

DIRECTED = (
    "back_load",
    "rest_load",
    "rest_back_load",
    "motor_load",
    "rest_motor_load",
    "rest_load_square",
    "rest_motor_square",
    "exponent",
)  # keys of the law that knows the direction of power
OF_MOTOR_TORQUE = ("motor_load", "rest_motor_load")  # not distinguished where that is the gear's

# Needs of a record that shows its numbers.
UNDER_LOAD = "motion under loads of many sizes"
DRIVEN = "motion in which the link drives the motor, under loads of many sizes"
OF_MOTOR = "motion in which the motor's torque differs from the gear's, behind an elastic gear"
SLOW = "motion slower than its `stribeck` speed; without one only breaking away shows it"
SLOWLY_DRIVEN = f"the link driving the motor in {SLOW}"


def _declare_optional(
    symbol: str,
    text: str,
    excitation: str,
    *,
    unit: str = "N m/(N m)",
    ends: Ends = (0.0, 10.0),
    absent: str = "0",
) -> Any:
    """Return a number that a scene may leave out; arguments as of `number`."""
    return number(
        symbol,
        unit,
        ends=ends,
        prior="known",
        excitation=excitation,
        default=None,
        absent=absent,
        text=text,
    )


class LoadFriction(Friction):
    """Further friction: `load` times the gear's torque on that shaft, and more of its kind.

    Numbers that begin with `rest_` fade with the speed, as breaking away does. Source: M. Duclusaud
    and G. Passault, ICRA 2025 (arXiv 2410.08650), and LossyGear of the Modelica Standard Library.
    """

    header = "frictions/load_friction.hpp"
    cxx = "LoadFriction"
    named_by = ("load",)

    stribeck: float | None = number(
        "vs",
        "rad/s",
        above=0.0,
        prior="known",
        excitation=SLOW,
        default=None,
        absent="Coulomb friction",
        text="vs, see [Stribeck friction](stribeck.md)",
    )
    load: float = number(
        "mu",
        "N m/(N m)",
        ends=(0.0, 10.0),
        prior="known",
        excitation=UNDER_LOAD,
        default=0.0,
        text="mu",
    )
    back_load: float | None = _declare_optional(
        "mu_back", "mu where the link drives the motor", DRIVEN, absent="`load`"
    )
    rest_load: float | None = _declare_optional("nu", "nu, as mu, at rest", SLOW)
    rest_back_load: float | None = _declare_optional(
        "nu_back", "nu where the link drives the motor", SLOWLY_DRIVEN, absent="`rest_load`"
    )
    motor_load: float | None = _declare_optional("m", "m, per torque of the motor", OF_MOTOR)
    rest_motor_load: float | None = _declare_optional("n", "n, as m, at rest", SLOW)
    rest_load_square: float | None = _declare_optional(
        "q",
        "q, per square of the gear's torque, at rest, where the motor drives",
        SLOW,
        unit="1/(N m)",
        ends=(0.0, None),
    )
    rest_motor_square: float | None = _declare_optional(
        "q_back",
        "q', per square of the motor's torque, at rest, where the link drives",
        SLOWLY_DRIVEN,
        unit="1/(N m)",
        ends=(0.0, None),
    )
    exponent: float | None = _declare_optional(
        "alpha",
        "α, of the speed in Stribeck's term",
        SLOW,
        unit="1",
        ends=(0.5, 20.0),
        absent="2",
    )

    @classmethod
    def is_named_in(cls, section: Section) -> bool:  # noqa: D102
        return any([section.has_key(key) for key in (*cls.named_by, *DIRECTED)])

    @property
    def is_directed(self) -> bool:
        """Whether it has a number of the law that knows the direction of power."""
        return any(getattr(self, key) is not None for key in DIRECTED)

    @property
    def cxx_type(self) -> str:  # noqa: D102
        if not self.is_directed:
            return super().cxx_type
        return f"arm::DirectedLoadFriction<{'true' if self.exponent is None else 'false'}>"

    def check_numbers(self, section: Section) -> None:  # noqa: D102
        super().check_numbers(section)
        if self.exponent is not None and self.stribeck is None:
            raise section.make_refusal("exponent", "come with a stribeck speed", self.exponent)

    def check_gear(self, gear: Gear | None, joint: Section) -> None:  # noqa: D102
        if gear is None:
            rule = "belong to a joint with a motor, whose gear is the load"
            raise joint.make_refusal(f"{self.section}.load", rule, self.load)
        if gear.stiffness is not None:
            return
        if self.load >= 1.0:
            rule = "be below 1 behind a rigid gear, whose efficiency is 1 - load"
            raise joint.make_refusal(f"{self.section}.load", rule, self.load)
        for key in OF_MOTOR_TORQUE if self.shaft == "rotor" else ():
            if getattr(self, key) is not None:
                instead = key.replace("motor_", "")
                rule = f"come with an elastic gear (a rigid one has the motor's torque: {instead})"
                raise joint.make_refusal(f"{self.section}.{key}", rule, getattr(self, key))

    def compute_dry_torque(self, motion: ShaftMotion) -> Array:  # noqa: D102
        dry = super().compute_dry_torque(motion)
        if not self.is_directed:
            if self.stribeck is not None:
                dry = compute_stribeck_torque(
                    self.coulomb, self.breakaway, self.stribeck, motion.speed
                )
            torque: Array = dry + self.load * np.abs(motion.gear_torque)
            return torque
        sign = np.where(motion.speed < 0.0, -1.0, 1.0)
        T = sign * motion.gear_torque
        A = sign * motion.motor_torque if self.shaft == "rotor" else T
        torque = dry + self._compute_load_torque(A, T, self.load, self.back_load, self.motor_load)
        if self.stribeck is not None:
            torque += self._compute_fading(A, T) * self._compute_remaining_share(motion.speed)
        return torque

    def _compute_fading(self, A: Array, T: Array) -> Array:
        """Return what is added to the sliding torque at rest [N m]."""
        fading = self.breakaway - self.coulomb
        of_load = self._compute_load_torque(
            A, T, self.rest_load or 0.0, self.rest_back_load, self.rest_motor_load
        )
        # Behind a rigid gear both are the motor's torque, up to rounding.
        ahead = np.abs(A) - np.abs(T)
        leads = np.where(np.abs(ahead) < 1e-12 * np.abs(T), T, ahead) > 0.0
        square = np.where(
            leads, (self.rest_load_square or 0.0) * T**2, (self.rest_motor_square or 0.0) * A**2
        )
        return np.asarray(fading + of_load + np.where(A * T > 0.0, square, 0.0))

    def _compute_remaining_share(self, speed: Array) -> Array:
        """Return the share of the fading terms that remains at a speed."""
        assert self.stribeck is not None
        with np.errstate(over="ignore"):
            power = np.abs(speed / self.stribeck) ** (
                2.0 if self.exponent is None else self.exponent
            )
        return np.asarray(np.exp(-np.minimum(power, 700.0)))

    @staticmethod
    def _compute_load_torque(
        A: Array, T: Array, forward: float, backward: float | None, of_motor: float | None
    ) -> Array:
        """Return the torque of a load friction, of torques in the direction of motion [N m]."""
        of_gear = np.where(T > 0.0, forward, forward if backward is None else backward)
        return np.asarray(np.abs((of_motor or 0.0) * A + of_gear * T))

    @property
    def can_stick(self) -> bool:  # noqa: D102
        numbers = (self.coulomb, self.load, *(getattr(self, key) for key in DIRECTED[:-1]))
        return any(value is not None and value > 0.0 for value in numbers)


@register_part
class LinkLoadFriction(LoadFriction, LinkFriction):
    """Friction of a link that grows with the load on its gear."""


@register_part
class RotorLoadFriction(OfRotor, LoadFriction):
    """Friction of a rotor that grows with the load on its gear."""
