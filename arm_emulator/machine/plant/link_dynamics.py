"""The links of a machine alone, by the compiled core: M(q) a + nle(q, v) = tau."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import POSITION
from arm_emulator.base.validation.number import Number
from arm_emulator.toolchain.c_header import make_pointer

QUANTITIES = {
    "q": Number.bound_size("q", "rad or m", POSITION.most),
    "v": Number.bound_size("v", "rad/s or m/s", math.inf),
    "a": Number.bound_size("a", "rad/s2 or m/s2", math.inf),
    "tau": Number.bound_size("tau", "N m or N", math.inf),
}
RESULTS = {
    name: Number.bound_size(f"what v, tau or a lead to, {name},", unit, math.inf)
    for name, unit in (("a", "rad/s2 or m/s2"), ("tau", "N m or N"), ("nle", "N m or N"))
}
_FLOAT = np.dtype(np.float64)
_CLOSE = (_FLOAT.itemsize,)  # strides of numbers one beside the other


class LinkDynamics:
    """Dynamics of the links, without motors and gears, under the external wrenches that act now.

    Arrays are (N,) or (K, N), base to tool; those of one call have the same shape. Whatever is
    refused is of another shape, not finite, or so large that the answer would not be finite.

    Args:
        call: makes a call of the machine's equations, by its name; the first one compiles them.
        joints: N.
    """

    def __init__(self, call: Callable[..., Any], joints: int) -> None:
        self._call, self._N, self._row = call, joints, (joints,)

    def __repr__(self) -> str:
        return f"<LinkDynamics of {self._N} joints>"

    def accelerations(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Array:
        """Return the accelerations a [rad/s2 or m/s2] under joint torques.

        Raises:
            Refusal: see `LinkDynamics`.
        """
        rows = self._convert_rows("accelerations", {"q": q, "v": v, "tau": tau})
        a = np.empty_like(rows[0])
        self._call("arm_forward_dynamics", a.size // self._N, *map(make_pointer, (*rows, a)))
        return _check_finite(a, "accelerations", "a")

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the joint torques tau [N m or N] that give the links accelerations.

        Raises:
            Refusal: see `LinkDynamics`.
        """
        rows = self._convert_rows("inverse_dynamics", {"q": q, "v": v, "a": a})
        tau = np.empty_like(rows[0])
        self._call("arm_inverse_dynamics", tau.size // self._N, *map(make_pointer, (*rows, tau)))
        return _check_finite(tau, "inverse_dynamics", "tau")

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), (N, N) or (K, N, N) [kg m2, kg m or kg].

        Raises:
            Refusal: see `LinkDynamics`.
        """
        (at,) = self._convert_rows("mass_matrix", {"q": q})
        return self._compute_dynamics(at, np.zeros_like(at))[0]

    def nle(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the nonlinear effects [N m or N]: gravity, centrifugal and Coriolis, wrenches.

        Raises:
            Refusal: see `LinkDynamics`.
        """
        at = self._convert_rows("nle", {"q": q, "v": v})
        return _check_finite(self._compute_dynamics(*at)[1], "nle", "nle")

    def _compute_dynamics(self, q: Array, v: Array) -> tuple[Array, Array]:
        M, nle = np.empty((*q.shape, self._N)), np.empty_like(q)
        self._call("arm_link_dynamics", q.size // self._N, *map(make_pointer, (q, v, M, nle)))
        return M, nle

    def _convert_rows(self, of: str, arguments: dict[str, ArrayLike]) -> Sequence[Array]:
        # The control code of one arm hands over rows, each period: those are taken at once.
        converted: list[Array] = []
        numbers: list[float] = []
        for value in arguments.values():
            if not isinstance(value, np.ndarray) or value.dtype is not _FLOAT:
                break
            if value.shape != self._row or value.strides != _CLOSE:
                break
            converted.append(value)
            numbers += value.tolist()
        else:
            if math.hypot(*numbers) <= POSITION.most:  # the narrowest bound
                return converted
        where = f"LinkDynamics.{of}"
        rows: list[Array] = []
        for quantity, values in arguments.items():
            bound = QUANTITIES[quantity]
            array = bound.check_numbers(where, values)
            shape = array.shape
            if len(shape) not in (1, 2) or shape[-1] != self._N:
                rule = f"have shape (K, {self._N}) or ({self._N},)"
                raise Refusal(where, quantity, rule, shape)
            if rows and shape != rows[0].shape:
                raise Refusal(where, quantity, f"have the shape of q, {rows[0].shape}", shape)
            bound.check_values(where, array)
            rows.append(array)
        return rows


def _check_finite(values: Array, of: str, quantity: str) -> Array:
    RESULTS[quantity].check_values(f"LinkDynamics.{of}", values)
    return values
