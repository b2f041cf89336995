"""A requirement on the vibration of the tool after the last stop of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from arm_emulator.extension.base import Array, Number, Refusal, Section
from arm_emulator.extension.machine import (
    VIBRATION_QUANTITIES,
    Scene,
    ToolChain,
    compute_count_angle,
    find_reference_end,
    list_tool_signals,
    measure_vibration,
)

KEY = "vibration"
SOURCES = ("truth", "encoders")
_LIMITS = {
    unit: Number("at_most", unit, at_least=0.0, at_most=1e3)
    for unit in VIBRATION_QUANTITIES.values()
}
_BAND = Number("band", "m", above=0.0, at_most=1e3, default=1e-4)


class VibrationRequirement:
    """`at_most` less a quantity of the vibration after the last change of the joint targets.

    Attributes:
        names: signals that it needs, in the order of their rows.

    Args:
        section: `vibration`, the quantity; `at_most`; `from` truth or encoders; `band`.
        scene: the machine.

    Raises:
        Refusal: another quantity or number, or a scene without a tool or encoder.
    """

    def __init__(self, section: Section, scene: Scene) -> None:
        self._section, self._period = section, scene.servo_period
        first = next(iter(VIBRATION_QUANTITIES))
        self._quantity = section.read_choice(KEY, tuple(VIBRATION_QUANTITIES), first)
        self._limit = section.read_number(_LIMITS[VIBRATION_QUANTITIES[self._quantity]])
        self._source = section.read_choice("from", SOURCES, SOURCES[0])
        self._band = section.read_number(_BAND)
        section.refuse_unread_keys()
        joints = scene.joint_names
        scene.refuse_bearings("requirements of vibration")
        if not list_tool_signals(scene):
            raise section.make_refusal(KEY, "be of a scene whose tool a joint carries", scene.name)
        read, self._scale = "q", np.ones(len(joints))
        if self._source == "encoders":
            read, self._scale = "measured.encoder_counts", compute_count_angle(scene)
            bare = [joint.name for joint in scene.joints if joint.sensors.encoder is None]
            if bare:
                raise section.make_refusal("from", "be truth without an encoder", ", ".join(bare))
        self._chain = ToolChain(scene)
        self._joints = len(joints)
        self.names = [f"{name}.{joint}" for name in (read, "target") for joint in joints]

    def judge_trace(self, trace: Sequence[Array]) -> float:
        """Return the margin for pieces (names, n) of a run; -inf where it ends too early."""
        rows = np.concatenate(trace, axis=1)
        read, targets = rows[: self._joints], rows[self._joints :]
        end = find_reference_end(targets.T)
        places = self._chain.compute_positions(self._scale[:, None] * read[:, end:]).T
        try:
            vibration = measure_vibration(places, self._period, self._band)
        except Refusal:
            return -math.inf
        return float(self._limit - getattr(vibration, self._quantity))
