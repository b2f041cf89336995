"""Scenes without what no other simulator of this report has: brakes, end stops, current loops."""

from __future__ import annotations

BARE: dict[str, None] = {
    "joints.*.brake": None,
    "joints.*.end_stops": None,
    "joints.*.motor.current_loop": None,
    "joints.*.motor.current_limit": None,
}
