"""The integrator of a scene: scheme, step, exchange between threads, location of events."""

import math
import sys
from dataclasses import dataclass
from typing import Self

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import number
from arm_emulator.base.validation.section import LARGEST_COUNT, Section
from arm_emulator.machine.schemes.known import KNOWN, LOCATING_SCHEMES, SCHEMES
from arm_emulator.machine.schemes.scheme import Scheme

EXCHANGES = ("predict", "lag")
DEEPEST_EXCHANGE = 4
EVENTS = ("step", "located")


@dataclass(frozen=True, kw_only=True)
class Integrator:
    """Scheme and step [s]."""

    scheme: str
    dt: float = number(
        "s",
        ends=(1e-9, 1.0),
        text="integration step, which divides `servo_period`; one of nine digits or more is taken "
        "as the part of the period that it stands for",
    )
    exchange: str  # between two threads, see core/schemes/two_threads.hpp
    exchange_depth: int = number(
        ends=(1, DEEPEST_EXCHANGE),
        whole=True,
        default=1,
        text="with two threads: how much earlier that sample is. From 2 on the way between the "
        "cores takes no time of a step, and its error is the larger",
    )
    events: str  # where modes of joints change, see core/schemes/event_location.hpp

    @property
    def method(self) -> type[Scheme]:
        """The scheme."""
        return KNOWN[self.scheme]

    @classmethod
    def read_section(cls, section: Section) -> Self:
        """Read the section."""
        return cls(
            scheme=section.read_choice("scheme", SCHEMES, default=SCHEMES[0]),
            exchange=section.read_choice("exchange", EXCHANGES, default=EXCHANGES[0]),
            events=section.read_choice("events", EVENTS, default=EVENTS[0]),
            **section.read_numbers(cls),
        )


def format_mismatch(integrator: Integrator, threads: int) -> tuple[str, str, object, str] | None:
    """Return a conflict of an integrator's settings: key, rule, value, valid ones."""
    scheme = integrator.scheme
    if threads == 2 and integrator.method.evaluations > 1:
        rule = f"be 1 with scheme {scheme}, whose second stage waits for its first"
        return "threads", rule, 2, "2 with another scheme"
    if integrator.events != "located":
        return None
    if not integrator.method.locates:
        rule = f"be step with scheme {scheme}, of first order at any event"
        valid = f"step, or located with scheme {' or '.join(LOCATING_SCHEMES)}"
    elif threads == 2:
        rule = "be step with 2 threads, whose links come from an earlier sample"
        valid = "step, or located with threads: 1"
    else:
        return None
    return "integrator.events", rule, "located", valid


def suggest_divisors(servo_period: float, dt: float, where: str) -> float:
    """Return the step [s] of which whole steps make a servo period, for one that has few digits."""
    nanoseconds = servo_period * 1e9
    # Up to the rounding of a number of whole nanoseconds.
    if abs(nanoseconds - round(nanoseconds)) > 4.0 * sys.float_info.epsilon * nanoseconds:
        nearest = f"{round(nanoseconds) * 1e-9:.10g} s, for example"
        rule = "be a whole number of nanoseconds"
        raise Refusal(where, "servo_period", rule, servo_period, nearest)
    steps = servo_period / dt
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-9 * steps:
        fitting = servo_period / max(1, math.ceil(steps - 1e-9))
        raise Refusal(
            where,
            "integrator.dt",
            f"divide the servo period of {servo_period:g} s",
            dt,
            f"{fitting!r} s, for example",
        )
    if steps > LARGEST_COUNT:
        raise Refusal(where, "integrator.dt", f"be >= {servo_period / LARGEST_COUNT:g} s", dt)
    return servo_period / round(steps)
