"""The emulated machine as a plain object: voltages in, states out. Knows nothing of ROS."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emulator_node.chain import Array
from emulator_node.compiler import library_of
from emulator_node.core_calls import declare
from emulator_node.scene import Scene
from emulator_node.stability import Attempt, attempts, what_holds
from words.bound import LARGEST_COUNT, POSITION, VELOCITY
from words.count import check_count
from words.refusal import Refusal

# What a joint without an encoder reports, since encoder counts are whole numbers.
IDEAL_COUNTS_PER_TURN = 2**20

LARGEST_STEPS = 10**15  # of one call
# Steps after which a long call looks whether Ctrl-C was pressed; so that the core's checks of its
# state stay where they are, a multiple of their distance (core/machine.hpp, kCheckEvery).
PIECE = 2**20
NOT_FINITE = -2  # what the core answers to a voltage that is not


class Diverged(RuntimeError):
    """The integration left the world of sound motions; the plant stays at the last state within.

    Its text says which joint, when, and which scheme and step would hold small motions there.

    Attributes:
        joint: the joint that left first, or that held the most of an energy from nowhere.
        t: logical time of the last state within bounds [s].

    Args:
        joint: see above.
        t: see above.
        dt: the step that it came of [s].
        scheme: the scheme that it came of.
        hint: what would hold, in words.
        trial: tries what holds, for `advice`.
    """

    def __init__(
        self,
        joint: str,
        t: float,
        dt: float,
        scheme: str,
        hint: str = "",
        trial: Callable[[], Iterator[Attempt]] | None = None,
    ) -> None:
        self.joint = joint
        self.t = t
        self._trial = trial
        super().__init__(
            f"Plant.advance: joint {joint} diverged after t = {t:.6g} s with scheme {scheme} at "
            f"dt = {dt:g} s; the plant stays at the last state before"
            + (f"; {hint}" if hint else "")
        )

    def advice(self) -> list[Attempt]:
        """Try what holds, and return every trial with its outcome; may compile and take seconds.

        The machine starts where the plant was reset, under the voltages that were applied last,
        and moves for twice the time to the divergence (half a second at least). Each other scheme
        is tried at the same step, then at halves of it until it holds; then the same scheme.
        """
        return list(self._trial()) if self._trial is not None else []


@dataclass(frozen=True)
class PlantState:
    """State of the machine at one logical time. Arrays are (N,), base to tool."""

    t: float  # s
    current: Array  # A
    theta_m: Array  # rad, motor angle
    omega_m: Array  # rad/s, motor speed
    q: Array  # rad or m, link side
    v: Array  # rad/s or m/s, link side
    gear_torque: Array  # N m or N, on the link
    encoder_counts: NDArray[np.int64]  # at the motor, floor


@dataclass(frozen=True)
class LinearDrive:
    """The linear part of one joint's drive, as the core states it (core/drive.hpp).

    With its n states z, D dz/dt = F (z, q, v, u), and the torque on the link is G (z, q, v, u) less
    `carried` times the link's acceleration.
    """

    D: Array  # (n,), 0 where a state follows at once
    F: Array  # (n, n + 3)
    G: Array  # (n + 3,)
    carried: float  # kg m2, of a rotor behind a rigid gear


class Plant:
    """Motors, gears and links of one scene, stepped by the compiled core.

    Attributes:
        core: the scene's compiled core, through ctypes (core/abi.hpp).
        machine: the core's handle of this machine.
        link_angle_per_count: what one encoder count means at the link (N,) [rad or m].

    Args:
        scene: from `emulator_node.scene.load_scene`.

    Raises:
        Refusal: the scene's core cannot be compiled.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.core = declare(library_of(scene))
        self._N = len(scene.joints)
        self._shape = (self._N,)
        self.machine = self.core.arm_new(scene.integrator.dt, scene.cores[1])
        self._voltage = np.zeros(self._N)
        self._voltage_pointer = _pointer(self._voltage)
        self._buffer = np.zeros((6, self._N))
        self._buffer_pointer = _pointer(self._buffer)
        turn = 2.0 * math.pi
        counts_per_turn = [
            joint.encoder.counts_per_turn if joint.encoder else IDEAL_COUNTS_PER_TURN
            for joint in scene.joints
        ]
        self._counts_per_rad = np.array(counts_per_turn) / turn
        self.link_angle_per_count = (
            np.array([joint.gear.ratio for joint in scene.joints]) / self._counts_per_rad
        )
        self.reset()

    def __del__(self) -> None:
        machine, self.machine = getattr(self, "machine", None), None
        if machine:
            self.core.arm_delete(machine)

    def reset(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> None:
        """Put the machine at logical time 0, its motors along with the links.

        No current flows, and the gears carry no torque.

        Args:
            q: link positions (N,) [rad or m], the scene's start if None.
            v: link speeds (N,) [rad/s or m/s], zero if None.

        Raises:
            Refusal: wrong shape, not finite, or too far away to be computed with; the state is as
                before.
        """
        at = self.scene.start if q is None else self._vector(q, "Plant.reset", "q", "rad or m")
        speed = (
            np.zeros(self._N) if v is None else self._vector(v, "Plant.reset", "v", "rad/s or m/s")
        )
        largest = np.minimum(POSITION.largest, LARGEST_COUNT * self.link_angle_per_count)
        if (np.abs(at) > largest).any():
            raise Refusal("Plant.reset", "q", f"be at most {largest.min():g} rad or m", at)
        if (np.abs(speed) > VELOCITY.largest).any():
            rule = f"be at most {VELOCITY.largest:g} rad/s or m/s"
            raise Refusal("Plant.reset", "v", rule, speed)
        self._reset_to = at, speed
        self.core.arm_reset(self.machine, _pointer(at), _pointer(speed))

    def advance(self, voltage: ArrayLike, steps: int) -> None:
        """Take `steps` integration steps with the motor voltages held.

        Args:
            voltage: (N,) [V], clamped to the supply voltage as the drives do; a joint without a
                motor takes no notice.
            steps: number of steps of `scene.integrator.dt`, 0 to 1e15.

        Raises:
            Refusal: wrong shape, not finite, or no such count; the state is as before.
            Diverged: the integration failed; the state is the last one within bounds.
        """
        # This is called every servo period: what fits is not looked at twice.
        if type(steps) is not int or not 0 <= steps <= PIECE:
            check_count("Plant.advance", "steps", steps, 0, LARGEST_STEPS)
        if not (isinstance(voltage, np.ndarray) and voltage.shape == self._shape):
            voltage = self._vector(voltage, "Plant.advance", "voltage", "V")
        try:
            np.copyto(self._voltage, voltage, casting="same_kind")
        except TypeError:
            raise Refusal("Plant.advance", "voltage", "be numbers [V]", voltage) from None
        advance, machine, pointer = self.core.arm_advance, self.machine, self._voltage_pointer
        joint = advance(machine, pointer, min(steps, PIECE))
        if joint == NOT_FINITE:
            raise Refusal("Plant.advance", "voltage", "be finite [V]", voltage)
        while joint < 0 and steps > PIECE:
            steps -= PIECE
            joint = advance(machine, pointer, min(steps, PIECE))
        self._check(joint)

    def run(self, voltages: ArrayLike, steps: int) -> Array:
        """Apply rows of voltages one after the other, without coming back to Python in between.

        Args:
            voltages: (K, N) [V].
            steps: integration steps under each row, >= 0; with all rows at most 1e15.

        Returns:
            Link positions after each row, (K, N) [rad or m].

        Raises:
            Refusal: wrong shape, not finite, or no such count; the state is as before.
            Diverged: as `advance`.
        """
        rows = np.atleast_2d(_numbers(voltages, "Plant.run", "voltages", "V"))
        if rows.ndim != 2 or rows.shape[1] != self._N:
            raise Refusal("Plant.run", "voltages", f"have shape (K, {self._N})", rows.shape)
        if not np.isfinite(rows).all():
            raise Refusal("Plant.run", "voltages", "be finite [V]", rows)
        check_count("Plant.run", "steps", steps, 0, LARGEST_STEPS // max(1, len(rows)))
        q = np.zeros_like(rows)
        if steps > PIECE:
            for row, after in zip(rows, q, strict=True):
                self.advance(row, steps)
                after[:] = self.state.q
            return q
        at_once = max(1, PIECE // max(1, steps))
        for first in range(0, len(rows), at_once):
            some, began = rows[first : first + at_once], self.t
            pointers = _pointer(some), len(some), steps, _pointer(q[first:])
            joint = self.core.arm_run(self.machine, *pointers)
            if joint >= 0:
                done = int((self.t - began) / (max(1, steps) * self.scene.integrator.dt) + 1e-6)
                self._check(joint, some[min(done, len(some) - 1)])
        return q

    def fault(
        self, joint: int, t: float, q: Array, v: Array, voltage: ArrayLike | None = None
    ) -> Diverged:
        """Return what to raise when a joint, by its index, left the bounds after the state given.

        Args:
            joint: its index.
            t: logical time of that state [s].
            q: its link positions (N,) [rad or m].
            v: its link speeds (N,) [rad/s or m/s].
            voltage: applied then (N,) [V]; None: those of the last `advance`.
        """
        now = self.scene.integrator
        applied = np.array(self._voltage if voltage is None else voltage)
        duration = max(0.5, 2.0 * t)
        trial = partial(attempts, self.scene, *self._reset_to, applied, duration)
        hint = what_holds(self, q, v)
        return Diverged(self.scene.joint_names[joint], t, now.dt, now.scheme, hint, trial)

    def _check(self, joint: int, voltage: ArrayLike | None = None) -> None:
        if joint >= 0:
            state = self.state
            raise self.fault(joint, state.t, state.q, state.v, voltage)

    @property
    def t(self) -> float:
        """Logical time [s]."""
        return float(self.core.arm_time(self.machine))

    @property
    def energy(self) -> float:
        """Kinetic, potential, elastic and magnetic energy [J]; potential is 0 at the base link."""
        return float(self.core.arm_energy(self.machine))

    @property
    def state(self) -> PlantState:
        """The state now, as a copy."""
        self.core.arm_state(self.machine, self._buffer_pointer)
        current, theta_m, omega_m, q, v, gear_torque = self._buffer.copy()
        counts = self._counts(theta_m)
        return PlantState(self.t, current, theta_m, omega_m, q, v, gear_torque, counts)

    def encoder_counts(self, theta_m: ArrayLike) -> NDArray[np.int64]:
        """Return what the encoders show at the motor angles (N,) [rad].

        Raises:
            Refusal: wrong shape, not finite, or more counts than there are.
        """
        at = self._vector(theta_m, "Plant.encoder_counts", "theta_m", "rad")
        if (np.abs(at * self._counts_per_rad) > LARGEST_COUNT).any():
            rule = f"be at most {LARGEST_COUNT:g} counts"
            raise Refusal("Plant.encoder_counts", "theta_m", rule, at)
        return self._counts(at)

    def _counts(self, theta_m: Array) -> NDArray[np.int64]:
        return np.floor(theta_m * self._counts_per_rad).astype(np.int64)

    def link_accelerations(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Array:
        """Return the accelerations of the links alone: M(q) a + nle(q, v) = tau.

        Args:
            q: (K, N) or (N,) positions [rad or m].
            v: speeds, of the same shape.
            tau: joint torques [N m or N], of the same shape.

        Raises:
            Refusal: different or wrong shapes, not finite, q too far away, or so large that a is
                not finite.
        """
        where = "Plant.link_accelerations"
        rows: list[Array] = []
        for values, quantity, unit in (
            (q, "q", "rad or m"), (v, "v", "rad/s or m/s"), (tau, "tau", "N m or N")
        ):  # fmt: skip
            array = _numbers(values, where, quantity, unit)
            if array.ndim not in (1, 2) or array.shape[-1] != self._N:
                rule = f"have shape (K, {self._N}) or ({self._N},)"
                raise Refusal(where, quantity, rule, array.shape)
            if rows and array.shape != rows[0].shape:
                raise Refusal(where, quantity, f"have the shape of q, {rows[0].shape}", array.shape)
            if not np.isfinite(array).all():
                raise Refusal(where, quantity, f"be finite [{unit}]", array)
            rows.append(array)
        if (np.abs(rows[0]) > POSITION.largest).any():
            raise Refusal(where, "q", f"be at most {POSITION.largest:g} rad or m", rows[0])
        a = np.empty_like(rows[0])
        self.core.arm_forward_dynamics(a.size // self._N, *map(_pointer, (*rows, a)))
        if not np.isfinite(a).all():
            raise Refusal(where, "what v and tau lead to", "be finite [rad/s2 or m/s2]", a)
        return a

    def linear_drives(self) -> list[LinearDrive]:
        """Return what each joint's drive is for small motions, base to tool."""
        K = self.core.arm_linear_drives(None)
        numbers = np.zeros((self._N, 2 + K + (K + 1) * (K + 4)))
        self.core.arm_linear_drives(_pointer(numbers))
        drives = []
        for row in numbers:
            n, (D, F, G) = int(row[0]), np.split(row[2:], [K, K + K * (K + 4)])
            own = [*range(n), K, K + 1, K + 2]
            F = F.reshape(K, K + 4)[:n, own]
            drives.append(LinearDrive(D[:n], F, G[own], float(row[1])))
        return drives

    def _vector(self, values: ArrayLike, where: str, quantity: str, unit: str) -> Array:
        array = _numbers(values, where, quantity, unit)
        if array.shape != (self._N,):
            raise Refusal(where, quantity, f"have shape ({self._N},)", array.shape)
        if not np.isfinite(array).all():
            raise Refusal(where, quantity, f"be finite [{unit}]", array)
        return array


def _numbers(values: ArrayLike, where: str, quantity: str, unit: str) -> Array:
    """Return a copy of `values` as numbers, row by row."""
    try:
        return np.array(values).astype(np.float64, order="C", casting="same_kind")
    except (TypeError, ValueError):
        raise Refusal(where, quantity, f"be numbers [{unit}]", values) from None


def _pointer(array: Array) -> Any:
    return array.ctypes.data_as(ctypes.c_void_p)
