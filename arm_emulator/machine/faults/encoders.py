"""Faults of encoders, at motors and at links."""

from __future__ import annotations

from arm_emulator.base.number import Number
from arm_emulator.machine.faults.fault import HOLDS, RISES, STUCK, Fault, rise, share


def _kinds(section: str, what: str) -> tuple[Fault, ...]:
    def kind(name: str, text: str, key: str, magnitude: Number, expression: str = RISES) -> Fault:
        sets = {f"{section}.{key}": expression}
        text = f"{what}: {text}"
        return Fault(
            name=f"{section}_{name}", text=text, sets=sets, magnitude=magnitude, absent=0.0
        )

    return (
        kind("slips", "the disc turns on its shaft", "offset", rise("rad", 0.1, 1e3, signed=True)),
        kind("misses_edges", "edges, or words of an absolute encoder, are missed", "missed",
             share(0.1, 0.5), "{x} + {m} * (1.0 - 2.0 * {x})"),
        kind("stuck", STUCK, "held", share(), HOLDS),
        kind("flips_bits", "a bit of a reading is wrong", "flips", share(0.1), HOLDS),
        kind("noisy", "the shield is broken", "noise", rise("rad", 1e-3, 1.0)),
        kind("off_centre", "the disc has lost its centre", "eccentricity", rise("rad", 0.01, 1.0)),
        kind("ripples", "the sine and cosine signals differ", "ripple", rise("rad", 1e-3, 1.0)),
    )  # fmt: skip


FAULTS = (*_kinds("encoder", "encoder"), *_kinds("link_encoder", "encoder at the link"))
