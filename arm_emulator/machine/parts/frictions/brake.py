"""Brakes on the shafts of motors."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.fault import Fault, bound_share, declare_fall
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@register_part
class Brake(Part):
    """Dry friction while the drives have no power."""

    section = "brake"
    shaft = "rotor"
    header = "frictions/brake.hpp"
    cxx = "Brake"
    outputs = (
        Output(
            "brake_closed", "whether each brake is closed", "joint.brake", kind="flag", cia=0x2004
        ),
    )

    torque: float = number(
        "torque", "N m", above=0.0, text="Tb, at the motor's shaft; at the link it is Tb / Ng"
    )
    close_delay: float = number(
        "close_delay",
        "s",
        ends=(0.0, 10.0),
        varied=False,
        default=0.0,
        text="from power off to closed",
    )
    release_delay: float = number(
        "release_delay",
        "s",
        ends=(0.0, 10.0),
        varied=False,
        default=0.0,
        text="from power on to open",
    )

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """None: in motion it is open."""
        return np.zeros_like(motion.t)

    @classmethod
    def list_faults(cls) -> tuple[Fault, ...]:
        """Faults of the brake; the drive reports its command, not these."""
        return (
            Fault(
                "brake_slips",
                "oil on the brake: it holds a smaller torque",
                sets=declare_fall("brake.torque"),
                magnitude=bound_share(0.9),
            ),
            Fault(
                "brake_stays_open",
                "the brake does not close, at a share of its way",
                sets=declare_fall("brake.closed"),
                magnitude=bound_share(),
            ),
            Fault(
                "brake_drags",
                "the brake presses while it is open, at 1 as if closed",
                sets={"brake.closed": "{x} + {m} * (1.0 - {x})"},
                magnitude=bound_share(),
            ),
        )

    def list_fault_numbers(self) -> dict[str, float | None]:
        """Its numbers, and whether it is closed, as it is before the drives get power."""
        return {**super().list_fault_numbers(), "closed": 1.0}

    def wrap_law(self, kind: str, law: str, own: str, closed: str) -> tuple[str, str]:
        """Return type and initialiser of a law of friction with this brake, in C++.

        Args:
            kind: type of the law.
            law: its initialiser.
            own: initialiser of the brake.
            closed: where the number stands that is 1 while the brake is closed.
        """
        braked = f"arm::Braked<{kind}>"
        return braked, f"{braked}{{{law}, {own}, {closed}}}"
