"""Contribution of a part to the error at rest behind our servo."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from arm_emulator.base.given import FloatArray
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


class Shape(enum.Enum):
    """Distribution of an unknown number between its largest values of either sign."""

    ANYWHERE = "anywhere"
    """All values are as likely."""
    ENDS = "ends"
    """Often at either end, else uniform."""
    SIDE = "side"
    """Often at the end on the side from which its joint comes, else uniform."""
    WAVE = "wave"
    """The sine of a uniform angle."""


@dataclass(frozen=True)
class Unknown:
    """An unknown number, independent of all others except for its joint's side."""

    most: float
    shape: Shape = Shape.ANYWHERE
    end: float = 1.0
    """Share of the largest value from which on it counts as an end."""
    often: float = 0.5
    """Share of cases at an end."""

    def scaled(self, factor: float) -> Unknown:
        """Return it times a factor; a side changes with the sign."""
        size = factor if self.shape is Shape.SIDE else abs(factor)
        return replace(self, most=size * self.most)

    def draw(self, rng: np.random.Generator, side: FloatArray) -> FloatArray:
        """Return values for joints that come from the sides +1 and -1."""
        anywhere = rng.uniform(-1.0, 1.0, side.shape)
        if self.shape is Shape.WAVE:
            return self.most * np.sin(np.pi * anywhere)
        if self.shape is Shape.ANYWHERE:
            return self.most * anywhere
        end = side if self.shape is Shape.SIDE else rng.choice([-1.0, 1.0], side.shape)
        end = end * rng.uniform(self.end, 1.0, side.shape)
        return self.most * np.where(rng.random(side.shape) < self.often, end, anywhere)


@dataclass(frozen=True)
class Around:
    """Sum of a known number and unknown ones."""

    centre: float = 0.0
    unknown: tuple[Unknown, ...] = ()

    def __add__(self, other: Around) -> Around:
        """Return the sum of two that are independent."""
        return Around(self.centre + other.centre, self.unknown + other.unknown)

    def scaled(self, factor: float) -> Around:
        """Return it times a factor."""
        unknown = tuple(one.scaled(factor) for one in self.unknown)
        return Around(factor * self.centre, unknown)

    @property
    def within(self) -> float:
        """Largest distance from its centre."""
        return sum(abs(one.most) for one in self.unknown)


@dataclass(frozen=True)
class Stuck:
    """Range of positions around its target in which a servo may leave its joint."""

    short: float = 0.0
    """On the side that the joint comes from."""
    beyond: float = 0.0
    """On the other one."""

    def __or__(self, other: Stuck) -> Stuck:
        """Return where the joint may be left for the one reason or the other."""
        return Stuck(max(self.short, other.short), max(self.beyond, other.beyond))


@dataclass(frozen=True)
class AtRest:
    """A joint at rest, as far as it is known before the motion. Units: N m, rad; N, m."""

    q: float  # of the link
    theta: float  # of the motor [rad]
    theta_within: float  # how well that is known [rad]
    start: float  # where the motor starts [rad]
    ratio: float  # link turns per motor turn
    rigid: bool  # whether the link turns with its rotor
    torque: Around  # what the link takes to rest there
    stiffness: float  # torque per angle off that our servo gives at once, at the link
    integral: float  # and that it has added by the end
    count: float  # of the motor's encoder, within which it asks for nothing, at the link

    @property
    def motion(self) -> ShaftMotion:
        """The link that stands there, as a motion of one sample."""
        still = np.zeros(1)
        torque = np.array([self.torque.centre])
        return ShaftMotion(still, np.array([self.q]), still, still, torque, torque, self.ratio)

    def stuck(self, holds: float, slides: float) -> Stuck:
        """Return the range in which a sticking motor may miss its target.

        While it slides, the servo's integral comes to what it feels, the sooner the longer its way
        is. Where it stops short, the integral has since grown by less than what holds it. Once it
        has, the motor slips by what the two torques differ by; but within a count of its target
        it has not been pushed.

        Args:
            holds: torque that it withstands at rest, at the link.
            slides: that it feels while it turns.
        """
        way = abs(self.ratio * (self.theta - self.start))
        lacks = slides * min(1.0, slides / max(self.stiffness * way, slides)) if slides else 0.0
        slip = (holds - slides) / self.stiffness
        return Stuck((holds - slides + lacks) / self.integral, max(0.0, slip - 0.5 * self.count))


@dataclass(frozen=True)
class Share:
    """Contribution of one part. Units: N m, rad at the link; N, m of a prismatic joint."""

    torque: Around = Around()
    """On the link, beside weight: known, or whatever it takes within, as dry friction does."""
    ahead: Around = Around()
    """Servo's error of the link's position, > 0 if it assumes the link ahead."""
    stuck: Stuck = Stuck()
    """Range about the target in which the servo does not correct."""
    angle_noise: float = 0.0
    """Standard deviation of the motor's angle as measured in a servo period [rad]."""
    current_noise: float = 0.0
    """Standard deviation of the current as measured in a servo period [A]."""


def waves_at(waves: Sequence[tuple[float, float, float]], angle: float, within: float) -> Around:
    """Return the sum of waves (order, amplitude, phase) at an uncertain angle.

    Where a wave may pass through a good part of its period, it may have any of its values.
    """
    centre, unknown = 0.0, []
    for order, amplitude, phase in waves:
        turned = abs(order) * within
        if turned > 1.0:
            unknown.append(Unknown(abs(amplitude), Shape.WAVE))
            continue
        x = order * angle + phase
        centre += amplitude * math.sin(x)
        moves = abs(amplitude) * (abs(math.cos(x)) * turned + 0.5 * turned**2)
        unknown.append(Unknown(moves))
    return Around(centre, tuple(one for one in unknown if one.most))
