"""What Python calls in a scene's compiled core: the functions of core/abi.hpp."""

from __future__ import annotations

import ctypes
from typing import Any

_pointer, _int, _count, _double = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64, ctypes.c_double

CALLS: dict[str, tuple[Any, list[Any]]] = {
    "arm_new": (_pointer, [_double, _int]),
    "arm_delete": (None, [_pointer]),
    "arm_reset": (None, [_pointer] * 3),
    "arm_advance": (_int, [_pointer, _pointer, _count]),
    "arm_run": (_int, [_pointer, _pointer, _count, _count, _pointer]),
    "arm_time": (_double, [_pointer]),
    "arm_energy": (_double, [_pointer]),
    "arm_state": (None, [_pointer, _pointer]),
    "arm_linear_drives": (_int, [_pointer]),
    "arm_real_time_new": (_pointer, [_pointer, _count, _count, _int]),
    "arm_real_time_delete": (None, [_pointer]),
    "arm_real_time_start": (None, [_pointer, _count]),
    "arm_real_time_stop": (None, [_pointer]),
    "arm_real_time_command": (None, [_pointer, _count, _pointer]),
    "arm_real_time_power": (None, [_pointer, _int]),
    "arm_real_time_take": (_int, [_pointer, _pointer]),
    "arm_real_time_descriptor": (_int, [_pointer]),
    "arm_real_time_status": (None, [_pointer, _pointer]),
    "arm_real_time_clear_figures": (None, [_pointer]),
    "arm_forward_dynamics": (None, [_count] + [_pointer] * 4),
}
"""Result and arguments of each, by its name."""


def declare(core: ctypes.CDLL) -> ctypes.CDLL:
    """Tell ctypes the signatures."""
    for name, (result, arguments) in CALLS.items():
        function = getattr(core, name)
        function.restype, function.argtypes = result, arguments
    return core
