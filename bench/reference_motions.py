"""The motions that the measurements are made on."""

from __future__ import annotations

import numpy as np

from arm_emulator.base.arrays import Array

SERVO_PERIOD = 1e-3  # s
AMPLITUDE = 12.0  # V, a quarter of the scenes' supply


def make_sines(
    joints: int, seed: int, period: float = SERVO_PERIOD, duration: float = 1.0
) -> Array:
    """Return motor voltages, a sine per joint, each row to be held over one servo period.

    Frequencies of 0.3 to 1.5 Hz and phases are drawn by `seed`. The voltages start with a jump,
    which stirs up currents and gears, and jump on with each period, as a servo's do.

    Returns:
        (duration / period, joints) [V].
    """
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(0.3, 1.5, joints)
    phase = rng.uniform(0.0, 2.0 * np.pi, joints)
    t = period * np.arange(round(duration / period))[:, None]
    return AMPLITUDE * np.sin(2.0 * np.pi * frequency * t + phase)
