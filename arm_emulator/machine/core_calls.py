"""What Python calls in compiled libraries: arm.h, arm_fleet.h and real_time.h of core/boundary."""

from __future__ import annotations

import ctypes
from typing import Any

from arm_emulator.build.unit import Calls

VERSION = 2  # of arm.h
OK, REFUSED, DIVERGED = range(3)  # enum arm_result
FAULT_THERMAL = 2  # of enum arm_fault
MODES = {"V": 1, "N m": 2, "A": 4, "V dq": 8}  # enum arm_mode, by the unit of the command

_pointer, _int, _count, _double = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64, ctypes.c_double
_int32, _uint32, _uint64 = ctypes.c_int32, ctypes.c_uint32, ctypes.c_uint64

ARM_CALLS: Calls = {
    "arm_describe": (_int, [_pointer]),
    "arm_describe_joint": (_int, [_int32, _pointer]),
    "arm_describe_reading": (_int, [_int32, _int32, _pointer]),
    "arm_new": (_pointer, [_pointer]),
    "arm_delete": (None, [_pointer]),
    "arm_reset": (_int, [_pointer] * 3),
    "arm_join_schedule": (_int, [_pointer]),
    "arm_exchange": (_int, [_pointer] * 3),
    "arm_measure": (_int, [_pointer] * 2),
    "arm_power": (None, [_pointer, _int]),
    "arm_why": (_int, [_pointer] * 2),
    "arm_describe_parameter": (_int, [_int32, _pointer]),
    "arm_get_parameter": (_int, [_pointer, ctypes.c_char_p, _pointer]),
    "arm_set_parameter": (_int, [_pointer, ctypes.c_char_p, _double]),
    "arm_set_external_wrench": (_int, [_pointer, _int32, _pointer]),
    "arm_get_external_wrench": (_int, [_pointer, _int32, _pointer]),
    "arm_measure_time": (None, [_pointer]),
    "arm_spent": (_count, [_pointer]),
    "arm_saved_size": (_count, []),
    "arm_save": (_int, [_pointer, _pointer, _count]),
    "arm_restore": (_int, [_pointer, _pointer, _count]),
    "arm_get_truth": (_int, [_pointer] * 2),
    "arm_get_winding_temperatures": (None, [_pointer] * 2),
    "arm_set_truth": (_int, [_pointer] * 2),
    "arm_advance": (_int, [_pointer, _pointer, _count]),
    "arm_run": (_int, [_pointer, _pointer, _count, _count, _pointer]),
    "arm_powers": (_int, [_pointer] * 3),
    "arm_advance_metered": (_int, [_pointer, _pointer, _count, _pointer]),
    "arm_linear_drives": (_int, [_pointer, _int, _pointer]),
    "arm_forward_dynamics": (None, [_pointer, _count] + [_pointer] * 4),
}

FLEET_CALLS: Calls = {
    **ARM_CALLS,
    "arm_fleet_lanes": (_int32, []),
    "arm_fleet_new": (_pointer, [_pointer, _int32]),
    "arm_fleet_delete": (None, [_pointer]),
    "arm_fleet_machine": (_pointer, [_pointer, _int32]),
    "arm_fleet_run": (_int, [_pointer, _int32, _int32, _pointer, _count, _count, _pointer]),
    "arm_fleet_get_truth": (_int, [_pointer] * 2),
}

REAL_TIME_CALLS: Calls = {
    "arm_real_time_new": (_pointer, [_pointer]),
    "arm_real_time_delete": (None, [_pointer]),
    "arm_real_time_start": (None, [_pointer, _count]),
    "arm_real_time_stop": (None, [_pointer]),
    "arm_real_time_go_on": (None, [_pointer]),
    "arm_real_time_command": (None, [_pointer] * 2),
    "arm_real_time_take": (_int, [_pointer] * 2),
    "arm_real_time_descriptor": (_int, [_pointer]),
    "arm_real_time_get_figures": (None, [_pointer] * 2),
    "arm_real_time_clear_figures": (None, [_pointer]),
}


class _Sized(ctypes.Structure):
    """A struct that begins with its size."""

    def __init__(self, **fields: Any) -> None:
        super().__init__(size=ctypes.sizeof(self), **fields)


class Refused(_Sized):
    """``arm_refusal``."""

    _fields_ = (
        ("size", _uint32),
        ("joint", _int32),
        ("quantity", ctypes.c_char * 40),
        ("rule", ctypes.c_char * 120),
        ("got", _double),
    )


class Options(_Sized):
    """``arm_options``."""

    _fields_ = (
        ("size", _uint32),
        ("core", _int32),
        ("step", _double),
        ("steps_per_period", _count),
        ("parameters", _pointer),
    )


class Command(_Sized):
    """``arm_command``; `joint` points to an array of JOINT_COMMAND."""

    _fields_ = (
        ("size", _uint32),
        ("reserved", _uint32),
        ("tick", _count),
        ("joint", _pointer),
        ("value_d", _pointer),
    )


class Measurement(_Sized):
    """``arm_measurement``; arrays of JOINT_MEASUREMENT, JOINT_SENSORS and IMU_MEASUREMENT."""

    _fields_ = (
        ("size", _uint32),
        ("powered", _uint32),
        ("tick", _count),
        ("answered", _count),
        *((name, _pointer) for name in ("joint", "sensors", "imu")),
        ("current_d", _pointer),
        ("readings", _pointer),
    )


class Wrench(_Sized):
    """``arm_wrench``."""

    _fields_ = (
        ("size", _uint32),
        ("axes", _int32),
        *((name, _double * 3) for name in ("point", "force", "moment")),
    )


class JointDescription(ctypes.Structure):
    """``arm_joint_description``."""

    _fields_ = (
        ("size", _uint32),
        ("modes", _uint32),
        ("name", ctypes.c_char_p),
        ("kind", _int32),
        ("reserved", _int32),
        *((name, _double) for name in ("gear_ratio", "counts_per_rad", "current_limit")),
        *((name, _count) for name in ("encoder_wrap", "link_encoder_wrap")),
        ("link_counts_per_rad", _double),
        ("sensors", _uint32),
        ("more", _uint32),
    )


class Truth(_Sized):
    """``arm_truth``."""

    _fields_ = (
        ("size", _uint32),
        ("fault", _int32),
        ("time", _double),
        *((name, _pointer) for name in ("energy", "current", "theta_m", "omega_m")),
        *((name, _pointer) for name in ("q", "v", "gear_torque")),
    )


class FleetTruth(_Sized):
    """``arm_fleet_truth``."""

    _fields_ = (
        ("size", _uint32),
        ("reserved", _uint32),
        *((name, _pointer) for name in ("fault", "t", "energy", "encoder_counts")),
        *((name, _pointer) for name in ("current", "theta_m", "omega_m", "q", "v", "gear_torque")),
    )


class Snapshot(_Sized):
    """``arm_snapshot``; its arrays are those of a `Measurement`."""

    _fields_ = (
        ("size", _uint32),
        ("reserved", _uint32),
        *((name, _count) for name in ("tick", "answered", "lateness", "spent")),
        ("truth", Truth),
        *((name, _pointer) for name in ("joint", "sensors", "imu", "current_d", "readings")),
    )


class RealTimeOptions(_Sized):
    """``arm_real_time_options``; the functions are addresses in the machine's library."""

    _fields_ = (
        ("size", _uint32),
        ("joints", _int32),
        *((name, _pointer) for name in ("machine", "exchange", "get_truth")),
        ("join_schedule", _pointer),
        ("period", _count),
        ("core", _int32),
        ("imus", _int32),
        ("readings", _int32),
        ("reserved", _int32),
    )


# ``arm_joint_command``, ``arm_joint_measurement`` and so on, for arrays of numpy.
JOINT_COMMAND = [("mode", "i4"), ("enable", "u4"), ("value", "f8")]
JOINT_MEASUREMENT = [
    ("encoder", "i8"),
    ("current", "f8"),
    ("voltage", "f8"),
    ("faults", "u4"),
    ("brake", "u4"),
]
JOINT_SENSORS = [
    *((name, "i8") for name in ("index", "index_pulses", "link_encoder")),
    *((name, "i8") for name in ("link_index", "link_index_pulses")),
    ("torque", "f8"),
]
IMU_MEASUREMENT = [("specific_force", "f8", 3), ("angular_rate", "f8", 3)]
