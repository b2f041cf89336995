"""Refusals of motions that must not begin."""

from __future__ import annotations

from arm_emulator.base.refusal import Refusal


class NoWay(Refusal):
    """Raised for a motion on which parts would touch, or the tool would go far past its end."""


class PastEnd(NoWay):
    """Raised for one on which the tool would go far past its end."""
