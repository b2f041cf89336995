"""What a part leaves of a target once its joint rests behind our servo."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@dataclass(frozen=True)
class Around:
    """A number that is known within something: `centre` plus or minus `within` at most.

    `deviation` is its standard deviation within: that of a number that may be anywhere there, if
    it is not given.
    """

    centre: float = 0.0
    within: float = 0.0
    deviation: float | None = None

    @property
    def spread(self) -> float:
        """Its standard deviation."""
        return self.within / math.sqrt(3.0) if self.deviation is None else self.deviation


# Counts: a motor that slips no farther soon comes to rest in that of its target.
SOON_THERE = 10.0
# Standard deviation of where a motor sticks, by how far it may stick off its target: most come to
# rest near it. Measured over many poses (bench/residuals.py).
SELDOM = 0.25


# Standard deviation, by the largest, of what is as likely at its largest as anywhere below.
OFTEN_LARGEST = math.sqrt(0.5 * (1.0 + 1.0 / 3.0))


@dataclass(frozen=True)
class AtRest:
    """A joint that rests, as far as it is known before it has moved. Units: N m, rad; N, m."""

    q: float  # of the link
    theta: float  # of the motor [rad]
    theta_within: float  # how well that is known [rad]
    start: float  # where the motor starts [rad]
    ratio: float  # link turns per motor turn
    rigid: bool  # whether the link turns with its rotor
    torque: float  # what the link takes to rest there
    torque_within: float  # how well that is known
    torque_spread: float  # its standard deviation
    stiffness: float  # torque per angle off that our servo gives at once, at the link
    integral: float  # and that it has added by the end
    count: float  # of the motor's encoder, within which it asks for nothing, at the link

    @property
    def motion(self) -> ShaftMotion:
        """The link that stands there, as a motion of one sample."""
        still = np.zeros(1)
        torque = np.array([self.torque])
        return ShaftMotion(still, np.array([self.q]), still, still, torque, torque, self.ratio)

    def stuck(self, holds: float, slides: float) -> Around:
        """Return where a motor that sticks may stand off its target.

        Args:
            holds: torque that it withstands at rest, at the link.
            slides: that it feels while it turns.
        """
        still = 2.0 * holds / self.integral  # the integral has not moved it on
        slip = 2.0 * (holds - slides) / self.stiffness  # or has, and it went beyond
        if slip < SOON_THERE * self.count:
            slip = 0.0
        return Around(0.0, still + slip, math.hypot(SELDOM * still, slip / math.sqrt(3.0)))


@dataclass(frozen=True)
class Share:
    """What one part leaves. Units: N m, rad at the link; N, m of a joint that slides."""

    torque: Around = Around()
    """On the link, beside weight: known, or whatever it takes within, as dry friction does."""
    ahead: Around = Around()
    """By how much the servo takes the link to be ahead of where it is."""
    stuck: Around = Around()
    """By how much the servo may leave its target alone."""
    angle_noise: float = 0.0
    """Standard deviation of the motor's angle as measured in a servo period [rad]."""
    current_noise: float = 0.0
    """Standard deviation of the current as measured in a servo period [A]."""


def waves_at(waves: Sequence[tuple[float, float, float]], angle: float, within: float) -> Around:
    """Return the sum of waves (order, amplitude, phase) at an angle that is known within something.

    Where a wave may pass through a good part of its period, it may have any of its values.
    """
    centre = bound = square = 0.0
    for order, amplitude, phase in waves:
        turned = abs(order) * within
        if turned > 1.0:
            bound += abs(amplitude)
            square += 0.5 * amplitude**2
            continue
        x = order * angle + phase
        centre += amplitude * math.sin(x)
        moves = abs(amplitude) * (abs(math.cos(x)) * turned + 0.5 * turned**2)
        bound += moves
        square += moves**2 / 3.0
    return Around(centre, bound, math.sqrt(square))
