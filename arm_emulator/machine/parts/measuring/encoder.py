"""Encoders, at the motor and at the link."""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import ClassVar, Self

from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import LARGEST_COUNT, Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.fault import (
    HOLDS,
    STUCK,
    Fault,
    bound_rise,
    bound_share,
    declare_sensor_fault,
)
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part

# Resolution of a joint without an encoder, since encoder counts are whole numbers.
IDEAL_COUNTS_PER_TURN = 2**20
KINDS = ("incremental", "absolute")
INDICES = ("none", "latch", "correct")  # what an index pulse does
LARGEST_ANGLE = 1e4  # rad, of errors

_COUNTS_PER_TURN = Number(
    "counts_per_turn",
    "counts",
    at_least=1,
    at_most=LARGEST_COUNT,
    whole=True,
    text="per turn of the shaft, per m of a slide; 2²⁰ where the motor has no encoder",
)
# Of a word; a servo computes with whole numbers up to 2^52.
_BITS = Number("bits", at_least=1, at_most=48, whole=True)
DELAY = Number(
    "delay",
    "servo periods",
    at_least=0,
    at_most=100,
    whole=True,
    default=0,
    text="delay of the readings",
)
_RIPPLE_ORDER = Number(
    "ripple_order",
    at_least=1,
    at_most=1_000_000,
    whole=True,
    default=2,
    text="refused without `ripple`",
)


@register_part
class Encoder(Part):
    """Encoder on the motor shaft; with `counts_per_turn` alone floor(theta_m counts / (2 pi)).

    What is None is absent. `turn` is what a turn is: 2 pi rad, or 1 m of a scale along a slide.
    """

    section = "encoder"
    shaft = "rotor"
    about: ClassVar[str] = "encoder"  # in texts
    header = "measuring/encoder.hpp"
    cxx = "Encoder"
    outputs: ClassVar[tuple[Output, ...]] = (
        Output("index_counts", "counts at each motor at its newest index pulse", "sensors.index",
               kind="count"),
        Output("index_pulses", "index pulses at each motor", "sensors.index_pulses", kind="count"),
    )  # fmt: skip

    keys = (
        Key(
            "kind",
            range=", ".join(f"`{kind}`" for kind in KINDS),
            absent=f"`{KINDS[0]}`",
            text="see above",
        ),
        _COUNTS_PER_TURN,
        Key(
            "bits",
            range="whole, as many as a turn takes, to 48",
            absent="refused of an absolute encoder",
            text="word length; refused of an incremental one",
        ),
        Key(
            "index",
            range=", ".join(f"`{index}`" for index in INDICES),
            absent=f"`{INDICES[0]}`",
            text="what an index pulse does; of an incremental encoder",
        ),
        DELAY,
        _RIPPLE_ORDER,
    )

    kind: str = KINDS[0]
    counts_per_turn: int
    index: str = INDICES[0]
    bits: int | None = None
    delay: int = 0
    turn: float = 2.0 * math.pi
    offset: float | None = number(
        "offset",
        "rad",
        ends=(-LARGEST_ANGLE, LARGEST_ANGLE),
        default=None,
        text="angle of the disc on its shaft; a change at run time is a slip",
    )
    eccentricity: float | None = number(
        "eccentricity",
        "rad",
        ends=(0.0, 1.0),
        default=None,
        text="amplitude of the error that repeats with a turn",
    )
    eccentricity_phase: float | None = number(
        "eccentricity_phase",
        "rad",
        ends=(-LARGEST_ANGLE, LARGEST_ANGLE),
        default=None,
        text="refused without `eccentricity`",
    )
    ripple: float | None = number(
        "ripple",
        "rad",
        ends=(0.0, 1.0),
        default=None,
        text="amplitude of the error that repeats `ripple_order` times in a turn",
    )
    ripple_order: int = 2
    ripple_phase: float | None = number(
        "ripple_phase",
        "rad",
        ends=(-LARGEST_ANGLE, LARGEST_ANGLE),
        default=None,
        text="refused without `ripple`",
    )
    noise: float | None = number(
        "noise",
        "rad",
        ends=(0.0, 1.0),
        default=None,
        text="standard deviation of the angle before rounding",
    )
    missed: float | None = number(
        "missed",
        "1",
        ends=(0.0, 0.5),
        default=None,
        text="probability that an edge is missed; that a word is lost",
    )
    held: float | None = number(
        "held",
        "1",
        ends=(0.0, 1.0),
        default=None,
        text="probability that a reading is lost and the previous one stands; edges "
        "are still counted",
    )
    flips: float | None = number(
        "flips",
        "1",
        ends=(0.0, 1.0),
        default=None,
        text="probability that a bit of a reading is wrong",
    )

    @classmethod
    def read_section(cls, section: Section, turn: float = 2.0 * math.pi) -> Self:
        """Return the encoder that a section describes.

        Args:
            section: of the scene.
            turn: what a turn of the shaft is [rad], or m of a scale along a slide.

        Raises:
            Refusal: a value breaks its rule.
        """
        kind = section.read_choice("kind", KINDS, default=KINDS[0])
        counts = section.read_integer(_COUNTS_PER_TURN)
        bits = None
        if kind == "absolute":
            bits = section.read_integer(replace(_BITS, at_least=max(1, (counts - 1).bit_length())))
        elif section.has_key("bits"):
            raise section.make_refusal("bits", "belong to an encoder of kind absolute", kind)
        index = section.read_choice("index", INDICES, default=INDICES[0])
        if kind == "absolute" and index != INDICES[0]:
            raise section.make_refusal(
                "index", "be left out of an encoder of kind absolute", repr(index)
            )
        numbers = cls.read_numbers(section)
        for key in ("ripple_order", "ripple_phase", "eccentricity_phase"):
            of = key.split("_")[0]
            if section.has_key(key) and numbers[of] is None:
                raise section.make_refusal(key, f"come with a key {of}", "alone")
        return cls(
            kind=kind,
            counts_per_turn=counts,
            index=index,
            bits=bits,
            delay=section.read_integer(DELAY),
            turn=turn,
            ripple_order=section.read_integer(_RIPPLE_ORDER),
            **numbers,
        )

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:  # noqa: D102
        kind = partial(declare_sensor_fault, cls.section, cls.about)
        return (
            kind("slips", "the disc turns on its shaft", "offset",
                 bound_rise("rad", 0.1, 1e3, signed=True)),
            kind("misses_edges", "edges, or words of an absolute encoder, are missed", "missed",
                 bound_share(0.1, 0.5), "{x} + {m} * (1.0 - 2.0 * {x})"),
            kind("stuck", STUCK, "held", bound_share(), HOLDS),
            kind("flips_bits", "a bit of a reading is wrong", "flips", bound_share(0.1), HOLDS),
            kind("noisy", "the shield is broken", "noise", bound_rise("rad", 1e-3, 1.0)),
            kind("off_centre", "the disc has lost its centre", "eccentricity",
                 bound_rise("rad", 0.01, 1.0)),
            kind("ripples", "the sine and cosine signals differ", "ripple",
                 bound_rise("rad", 1e-3, 1.0)),
        )  # fmt: skip

    @property
    def reports(self) -> tuple[Output, ...]:
        """Its index; counts exist without an encoder, too."""
        return () if self.index == INDICES[0] else self.outputs

    @property
    def is_ideal(self) -> bool:
        """Whether it reports exact counts of the shaft only."""
        return self == type(self)(counts_per_turn=self.counts_per_turn, turn=self.turn)

    @property
    def counts_per_rad(self) -> float:
        """Counts per rad, or per m."""
        return self.counts_per_turn / self.turn

    @property
    def wrap(self) -> int:
        """Counts after which its word wraps; 0 if it never does."""
        return 2**self.bits if self.bits is not None else 0

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:  # noqa: D102
        integers = {
            "kind": f"arm::EncoderKind::{self.kind}",
            "counts_per_turn": cxx_literals.format_number(self.counts_per_turn),
            "counts_per_rad": cxx_literals.format_number(self.counts_per_rad),
            "turns_per_rad": cxx_literals.format_number(1.0 / self.turn),
            "index": f"arm::Index::{self.index}",
            "bits": str(self.bits or 0),
            "delay": str(self.delay),
            "ripple_order": cxx_literals.format_number(self.ripple_order),
        }
        return [*integers.items(), *super().list_members(joint, places)]


@register_part
class LinkEncoder(Encoder):
    """Encoder at the link."""

    section: ClassVar[str] = "link_encoder"
    shaft = "link"
    about = "encoder at the link"
    outputs = (
        Output("link_encoder_counts", "counts of the encoder at each link", "sensors.link_encoder",
               kind="count"),
        Output("link_index_counts", "counts at each link at its newest index pulse",
               "sensors.link_index", kind="count"),
        Output("link_index_pulses", "index pulses at each link", "sensors.link_index_pulses",
               kind="count"),
    )  # fmt: skip

    @property
    def reports(self) -> tuple[Output, ...]:
        """Counts, and its index."""
        return self.outputs[:1] if self.index == INDICES[0] else self.outputs
