"""Scenes without what no other simulator of this report has.

Brakes, end stops, current loops, and steps that are cut at events.
"""

from __future__ import annotations

from arm_emulator.machine.parts.brake import Brake
from arm_emulator.machine.parts.known import DECORATORS, EXTRAS, without

BARE = {
    **without((Brake, *EXTRAS, *DECORATORS)),
    "joints.*.motor.current_limit": None,
    "integrator.events": "step",
}
