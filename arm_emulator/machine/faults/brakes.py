"""Faults of brakes. A drive reports the command of its brake, not these."""

from __future__ import annotations

from arm_emulator.machine.faults.fault import Fault, falling, share

FAULTS = (
    Fault(
        name="brake_slips",
        text="oil on the brake: it holds a smaller torque",
        sets=falling(("brake.torque",)),
        magnitude=share(0.9),
    ),
    Fault(
        name="brake_stays_open",
        text="the brake does not close, at a share of its way",
        sets=falling(("brake.closed",)),
        magnitude=share(),
    ),
    Fault(
        name="brake_drags",
        text="the brake presses while it is open, at 1 as if closed",
        sets={"brake.closed": "{x} + {m} * (1.0 - {x})"},
        magnitude=share(),
    ),
)
