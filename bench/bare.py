"""Scenes without what no other simulator of this report has: brakes, end stops, current loops."""

from __future__ import annotations

from arm_emulator.machine.parts.brake import Brake
from arm_emulator.machine.parts.known import DECORATORS, EXTRAS, without

BARE = {**without((Brake, *EXTRAS, *DECORATORS)), "joints.*.motor.current_limit": None}
