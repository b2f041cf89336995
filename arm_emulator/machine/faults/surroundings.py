"""Faults of what is around the arm: its supply and its base."""

from arm_emulator.machine.parts.fault import (
    Fault,
    bound_rise,
    bound_share,
    declare_fall,
    declare_rise,
)

FAULTS = (
    Fault(
        "supply_sags",
        "the voltage of all drives falls",
        of="",
        sets=declare_fall("supply.share"),
        magnitude=bound_share(0.8, 0.999),
    ),
    Fault(
        "base_tilts",
        "the base comes loose and leans over, about the world's x axis",
        of="",
        sets=declare_rise("base.tilt"),
        magnitude=bound_rise("rad", 0.1, 1.0, signed=True),
    ),
)
