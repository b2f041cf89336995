"""Faults of what is around the arm: its supply and its base."""

from __future__ import annotations

from arm_emulator.machine.parts.fault import Fault, falling, rise, rising, share

FAULTS = (
    Fault(
        name="supply_sags",
        of="",
        text="the voltage of all drives falls",
        sets=falling(("supply.share",)),
        magnitude=share(0.8, 0.999),
    ),
    Fault(
        name="base_tilts",
        of="",
        text="the base comes loose and leans over, about the world's x axis",
        sets=rising(("base.tilt",)),
        magnitude=rise("rad", 0.1, 1.0, signed=True),
    ),
)
