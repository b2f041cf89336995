"""Gears with play."""

from __future__ import annotations

import math

from arm_emulator.machine.parts.drawn import Numbers, Rng, scaled
from arm_emulator.machine.parts.elastic_gear import ElasticGear
from arm_emulator.machine.parts.fault import Fault, rise, rising
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.resting import Around, AtRest, Shape, Share, Unknown

NO_TORQUE = 1e-6  # N m, N: rounding


@register_part
class BacklashGear(ElasticGear):
    """An elastic gear whose teeth do not touch within its play."""

    header = "backlash.hpp"
    cxx = "BacklashGear"
    named_by = ("stiffness", "backlash")

    # Free play of the link with the motor held.
    backlash: float = number(
        "play", "rad", at_least=0.0, text="free play of the link while the motor is held"
    )

    @classmethod
    def drawn(cls, rng: Rng) -> Numbers:  # noqa: D102
        return super().drawn(rng) | {"backlash": scaled(rng, 1e-3, 2e-2)}

    @classmethod
    def faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        return (
            Fault(
                "backlash_grows",
                "the teeth wear, and the gear's play grows",
                sets=rising("gear.backlash"),
                magnitude=rise("rad", 1e-3, 1.0),
            ),
        )

    def rests(self, at: AtRest) -> Share | str:
        """Anywhere within the play, unless a torque holds the teeth on one side."""
        share = super().rests(at)
        if abs(at.torque.centre) > at.torque.within + NO_TORQUE or isinstance(share, str):
            return share
        # The link's stop takes its play, too.
        felt = [one for one in at.torque.unknown if one.shape is Shape.SIDE]
        shape, often = (Shape.SIDE, felt[0].often) if felt else (Shape.ENDS, 0.5)
        play = Around(0.0, (Unknown(0.5 * self.backlash, shape, often=often),))
        return Share(ahead=at.torque.scaled(1.0 / self.stiffness) + play)

    def wind_up(self, torque: float) -> float:
        """Return the gear's wind-up at rest, with the play."""
        free = math.copysign(0.5 * self.backlash, torque) if torque else 0.0
        return free + super().wind_up(torque)
