"""Scenes without what no other simulator of this report has: brakes and end stops."""

from __future__ import annotations

BARE: dict[str, None] = {"joints.*.brake": None, "joints.*.end_stops": None}
