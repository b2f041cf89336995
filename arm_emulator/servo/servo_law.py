"""The servo law of servo.c, compiled: its structs and functions, called from Python."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Calls, Unit, library
from arm_emulator.servo.c import FOLDER

_pointer, _int64, _int32, _double = ctypes.c_void_p, ctypes.c_int64, ctypes.c_int32, ctypes.c_double

SERVO_CALLS: Calls = {
    "servo_watchdog_reset": (None, [_pointer]),
    "servo_watchdog_target": (None, [_pointer, _int64]),
    "servo_watchdog_state": (None, [_pointer, _int64]),
    "servo_watchdog_check": (_int32, [_pointer, _int64]),
    "servo_reset": (None, [_pointer]),
    "servo_measure": (None, [_pointer, _int64] + [_pointer] * 3),
    "servo_aim": (None, [_pointer] * 4),
    "servo_voltage": (None, [_pointer, _int32, _pointer]),
    "servo_observe": (None, [_pointer] * 4),
    "servo_control": (None, [_pointer] * 5),
    "servo_release": (None, [_pointer]),
    "servo_joint_observe": (None, [_pointer] * 2 + [_int64, _double, _double]),
    "servo_joint_take": (None, [_pointer] * 2 + [_double] * 3),
    "servo_joint_control": (_double, [_pointer] * 2 + [_double] * 3),
    "servo_joint_drive": (_double, [_pointer] * 3),
}

FOLLOWS, HOLDS, CUT = range(3)  # enum servo_does
HEARS, NO_TARGET, LATE_TARGET, LATE_STATE = range(4)  # enum servo_silence


def _sum(name: str) -> tuple[str, list[tuple[str, str]]]:
    return name, [(part, "f8") for part in ("current", "speed", "voltage", "load")]


def _reals(*names: str) -> list[tuple[str, str]]:
    return [(name, "f8") for name in names]


# ``servo_joint`` and ``servo_state``, for arrays of numpy with an entry per joint.
JOINT: list[Any] = [
    ("wrap", "i8"),
    *_reals("count_angle", "ratio", "motor_turns", "torque_constant", "current_per_tau", "emf"),
    *_reals("omega_limit", "current_limit", "voltage_limit"),
    *_reals("position_gain", "velocity_gain", "reset_rate"),
    *map(_sum, ("end_current", "end_speed", "turn", "mean_current")),
    *_reals("voltage_per_current"),
    *_reals("speed_per_surplus", "turn_per_surplus", "voltage_per_surplus"),
    *_reals("current_memory", "winding", "current_voltage"),
    *_reals("theta_gain", "omega_gain", "load_gain"),
]
STATE: list[Any] = [
    ("counts", "i8"),
    ("known", "i4"),
    ("reserved", "i4"),
    *_reals("theta_measured", "theta", "omega", "load"),
    *_reals("current", "integral", "voltage", "unknown_voltage"),
    *_reals("q_target", "v_target", "tau", "q_hold"),
]
# ``servo_wish``.
WISH: list[Any] = [
    ("wants", "i4"),
    ("limited", "i4"),
    *_reals("q_target", "v_target", "tau", "omega", "current"),
    *_reals("least_omega", "most_omega", "least_current", "most_current"),
]
POSITION, SPEED, CURRENT = range(3)  # enum servo_wants
Rows = npt.NDArray[np.void]


class WatchdogStruct(ctypes.Structure):
    """``servo_watchdog``."""

    _fields_ = (
        *((name, _int64) for name in ("hold_after", "cut_after")),
        *((name, _int64) for name in ("last_target", "last_state", "silence")),
        *((name, _int32) for name in ("target_came", "state_came", "does", "cause")),
    )


class ServoStruct(ctypes.Structure):
    """``servo``."""

    _fields_ = (
        ("joints", _int32),
        ("restarts", ctypes.c_uint32),
        ("joint", _pointer),
        ("state", _pointer),
        ("watchdog", WatchdogStruct),
        *((name, _int64) for name in ("motion_period", "now", "target_time")),
        *((name, _int32) for name in ("measured", "aimed", "holding", "does")),
    )


@cache
def servo_law() -> ctypes.CDLL:
    """Return the compiled law, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return library(servo_unit())


def servo_unit() -> Unit:
    """Return the law as what is compiled."""
    source = '#include "servo.c"\n'
    return Unit("servo", source, C_FLAGS, (FOLDER,), SERVO_CALLS, "servo", "the servo", "servo.c")


def address(rows: npt.NDArray[Any]) -> int:
    """Return where an array lies."""
    return rows.ctypes.data
