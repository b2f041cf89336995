"""The emulated machine as a plain object: voltages in, states out. Knows nothing of ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.bound import CURRENT, LARGEST_COUNT, POSITION, VELOCITY, Bound
from arm_emulator.base.count import check_count
from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import NULL, CData, Library, pointer, text
from arm_emulator.machine.chain import Array
from arm_emulator.machine.compiler import library_of
from arm_emulator.machine.core_calls import (
    ARM,
    DIVERGED,
    FAULT_THERMAL,
    MODES,
    OK,
    PLACES,
    REFUSED,
)
from arm_emulator.machine.external_wrench import AXES, ExternalWrench, on_moving_link
from arm_emulator.machine.measured import Measured, MeasuredPlace
from arm_emulator.machine.scene import Scene

LARGEST_STEPS = 10**15  # of one call
PIECE = 2**20  # steps after which a long call looks whether Ctrl-C was pressed
SET = ("current", "theta_m", "omega_m", "q", "v")  # what decides on the others of `PlantState`
ROWS = (*SET, "gear_torque")


class Diverged(RuntimeError):
    """The integration left the world of sound motions; the plant stays at the last state within.

    Its text says which joint and when. `analysis.stability.explain` adds what would hold.

    Attributes:
        joint: the joint that left first, or that held the most of an energy from nowhere.
        t: logical time of the last state within bounds [s].
        scene: the machine.
        q: its link positions then (N,) [rad or m].
        v: its link speeds then (N,) [rad/s or m/s].
        voltage: applied then (N,) [V].
        began: positions and speeds to which it was reset before.
        hint: what would hold, in words, where somebody has found it out; part of the text.
    """

    def __init__(
        self,
        joint: str,
        t: float,
        scene: Scene,
        q: Array,
        v: Array,
        voltage: Array,
        began: tuple[Array, Array],
    ) -> None:
        self.joint, self.t, self.scene = joint, t, scene
        self.q, self.v, self.voltage, self.began = q, v, voltage, began
        self.hint = ""
        super().__init__(
            f"Plant.advance: joint {joint} diverged after t = {t:.6g} s with scheme "
            f"{scene.integrator.scheme} at dt = {scene.integrator.dt:g} s; the plant stays at the "
            "last state before"
        )

    def __str__(self) -> str:
        return super().__str__() + (f"; {self.hint}" if self.hint else "")


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
    encoder_counts: NDArray[np.int64]  # at the motor, as the encoder tells them


@dataclass(frozen=True)
class EnergyFlow:
    """What each joint is given and what it dissipates, (N,): W now, J over a time.

    It is given by the supply, and by the external wrench as far as that turns this joint.
    A motor whose torque constant differs from its back-EMF constant is given the difference, too.
    """

    given: Array
    dissipated: Array  # in windings, gears and friction


@dataclass(frozen=True)
class LinearDrive:
    """The linear part of one joint's drive, as the core states it (core/mechanics/drive.hpp).

    Of a progressive gear it is the linearisation where that is not wound up.

    With its n states z, D dz/dt = F (z, q, v, u), and the torque on the link is G (z, q, v, u) less
    `carried` times the link's acceleration.
    """

    D: Array  # (n,), 0 where a state follows at once
    F: Array  # (n, n + 3)
    G: Array  # (n + 3,)
    carried: float  # kg m2, of a rotor behind a rigid gear
    current: Array  # (n + 3,), A of the motor by (z, q, v, u)
    motor_angle: Array  # (n + 3,), rad


@dataclass(frozen=True)
class Borrowed:
    """A machine that belongs to somebody else, a `Fleet`."""

    owner: object
    core: Library
    machine: CData
    began: tuple[Array, Array]  # positions and speeds to which it was reset


class Plant:
    """Motors, gears and links of one scene, stepped by the compiled core.

    Attributes:
        core: the scene's compiled core (core/boundary/arm.h).
        machine: the core's handle of this machine.
        command, measurement: what `exchange` hands to the core.
        link_angle_per_count: what one encoder count means at the link (N,) [rad or m].
        bounds: how large what is set may be, by its name in `PlantState`.

    Args:
        scene: from `arm_emulator.machine.scene.load_scene`.
        of: a machine of this scene that belongs to a fleet; None: a new one.
        core: its compiled core with something beside it, see `compiler.library_with`.

    Raises:
        Refusal: the scene's core cannot be compiled.
    """

    def __init__(
        self, scene: Scene, *, of: Borrowed | None = None, core: Library | None = None
    ) -> None:
        self.scene = scene
        self.core = of.core if of else core or library_of(scene)
        self._N = N = len(scene.joints)
        self._shape = (N,)
        self._owner = of.owner if of else None  # it must not go before
        self.machine = of.machine if of else self._new()
        self._voltage = np.zeros(N)
        self._voltage_pointer = pointer(self._voltage)
        self._rows = np.zeros((len(ROWS), N))
        self._energy = np.zeros(1)
        # What is asked for, apart: without a place, energy and torques are not worked out.
        self._clock = truth_at()
        self._energy_alone = truth_at(energy=self._energy)
        self._truth = truth_at(**dict(zip(ROWS, self._rows, strict=True)))
        self._commands = commands_of(scene)
        self._commands_d = np.zeros(N)
        places = {"joint": self._commands, "value_d": self._commands_d}
        self.command = ARM.new("arm_command", tick=-1, **places)
        self._place = MeasuredPlace(scene)
        self._measured = self._place.joints
        self.measurement = ARM.new("arm_measurement", **self._place.arrays)
        self.link_angle_per_count = link_angle_per_count(scene)
        at_most = largest_position(scene)
        ratio = np.abs(scene.gear_ratios)
        self.bounds = {
            "current": CURRENT,
            "theta_m": Bound("motor position", "rad", at_most / ratio),
            "omega_m": Bound("motor velocity", "rad/s", VELOCITY.largest / ratio),
            "q": Bound("position", "rad", at_most),
            "v": VELOCITY,
        }
        if of:
            self._reset_to = of.began
        else:
            self.reset()

    def _new(self) -> CData:
        values = np.array([one.value for one in self.scene.varied])
        return self.core.arm_new(options_of(self.scene, values))

    def __del__(self) -> None:
        machine, self.machine = getattr(self, "machine", NULL), NULL
        if machine and self._owner is None:
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
        check_start("Plant.reset", self.scene, at, speed)
        self._reset_to = at.copy(), speed.copy()
        self.core.arm_reset(self.machine, pointer(at), pointer(speed))

    def advance(self, voltage: ArrayLike, steps: int) -> None:
        """Take `steps` integration steps with the motor voltages held.

        Args:
            voltage: (N,) [V], clamped to the supply voltage as the drives do, and 0 without power;
                a joint without a motor takes no notice.
            steps: number of steps of `scene.integrator.dt`, 0 to 1e15.

        Raises:
            Refusal: wrong shape, not finite, or no such count; the state is as before.
            Diverged: the integration failed; the state is the last one within bounds.
        """
        # This is called often: what fits is not looked at twice.
        if type(steps) is not int or not 0 <= steps <= PIECE:
            check_count("Plant.advance", "steps", steps, 0, LARGEST_STEPS)
        if not (isinstance(voltage, np.ndarray) and voltage.shape == self._shape):
            voltage = self._vector(voltage, "Plant.advance", "voltage", "V")
        try:
            np.copyto(self._voltage, voltage, casting="same_kind")
        except TypeError:
            raise Refusal("Plant.advance", "voltage", "be numbers [V]", voltage) from None
        advance, machine, applied = self.core.arm_advance, self.machine, self._voltage_pointer
        result = advance(machine, applied, min(steps, PIECE))
        if result == REFUSED:
            raise Refusal("Plant.advance", "voltage", "be finite [V]", voltage)
        while result == OK and steps > PIECE:
            steps -= PIECE
            result = advance(machine, applied, min(steps, PIECE))
        if result == DIVERGED:
            raise self._diverged(self._voltage)

    def exchange(self, voltage: Array, tick: int = -1, voltage_d: ArrayLike | None = None) -> None:
        """Go through one servo period under commands (N,) that answer a tick, -1: none.

        A command is a voltage, torque or current [V, N m, A], as the joint's motor takes it; of a
        motor in its rotor's frame it is the voltage across the flux, and `voltage_d` (N,) [V] that
        along it, 0 if None. Without power every command is 0.

        Raises:
            Refusal: not finite; nothing has changed.
            Diverged: as `advance`.
        """
        self._commands["value"] = voltage
        self._commands_d[:] = 0.0 if voltage_d is None else voltage_d
        self.command.tick = tick
        result = self.core.arm_exchange(self.machine, self.command, self.measurement)
        if result == REFUSED:
            raise self._refusal("Plant.exchange", "a number")
        if result == DIVERGED:
            raise self._diverged(self._measured["voltage"])

    def exchange_in(self, loop: Callable[[], int]) -> None:
        """Go through servo periods in a loop in C, over `command` and `measurement`.

        Args:
            loop: returns what ``arm_exchange`` returned last.

        Raises:
            Refusal: a command was refused; the machine is where it was then.
            Diverged: as `advance`.
        """
        result = loop()
        if result == REFUSED:
            raise self._refusal("Plant.exchange_in", "a number")
        if result == DIVERGED:
            raise self._diverged(self._measured["voltage"])

    def measure_time(self) -> None:
        """Measure from now on the wall time that steps take, for `spent_ns`."""
        self.core.arm_measure_time(self.machine)

    @property
    def spent_ns(self) -> int:
        """Wall time that steps have taken since `measure_time` [ns]."""
        return int(self.core.arm_spent(self.machine))

    @property
    def commanded(self) -> Array:
        """The newest commands of `exchange` or `exchange_in`, (N,) [V, N m, A]."""
        return self._commands["value"].copy()

    @property
    def voltage(self) -> Array:
        """What the motors got in the servo period that has passed (N,) [V], within the supply."""
        return self._measured["voltage"].copy()

    @property
    def measured(self) -> Measured:
        """What the sensors told at the newest tick, as a copy.

        Joints without sensors (docs/reference/parts/sensors.md) report their present values.
        """
        self.core.arm_measure(self.machine, self.measurement)
        return self._place.read()

    @property
    def current_d(self) -> Array:
        """Currents along the rotors' flux (N,) [A], 0 of motors that have one current only."""
        return self.measured.current_d

    @property
    def powered(self) -> bool:
        """Whether the drives have power; without it every command is 0."""
        self.core.arm_measure(self.machine, self.measurement)
        return bool(self.measurement.powered)

    @powered.setter
    def powered(self, on: bool) -> None:
        self.core.arm_power(self.machine, on)

    @property
    def parameters(self) -> dict[str, float]:
        """The numbers that the scene lists as varied, by name, with this machine's values."""
        return {one.name: self._parameter(one.name) for one in self.scene.varied}

    def set_parameter(self, name: str, value: float) -> None:
        """Set a varied number; the motion goes on from where it is. A reset leaves it as it is.

        Raises:
            Refusal: the scene does not list it as varied, or a value out of its range.
        """
        known = {one.name: one for one in self.scene.varied}
        if name not in known:
            raise Refusal(
                "Plant.set_parameter", "name", "be varied in the scene", name,
                ", ".join(known) or "none, see `varied` in docs/reference/scene.md",
            )  # fmt: skip
        one = known[name]
        if not isinstance(value, int | float) or not one.least <= value <= one.most:
            rule = f"be a number from {one.least:g} to {one.most:g}"
            raise Refusal("Plant.set_parameter", name, rule, value)
        self.core.arm_set_parameter(self.machine, name.encode(), float(value))

    def _parameter(self, name: str) -> float:
        value = np.zeros(1)
        self.core.arm_get_parameter(self.machine, name.encode(), pointer(value))
        return float(value[0])

    def set_external_wrench(self, link: str, wrench: ExternalWrench) -> None:
        """Let a force and a moment act on a link, until set anew or reset.

        On what one joint moves there is one of them, that which was set last.

        Args:
            link: any link of the URDF that moves; the wrench is about a point of it.
            wrench: what acts.

        Raises:
            Refusal: the scene has no `external_wrench`, no such link, or numbers that are not
                finite or too large; nothing has changed.
        """
        where = "Plant.set_external_wrench"
        joint, wrench = on_moving_link(self.scene, where, link, wrench)
        vectors = {name: getattr(wrench, name) for name in ("point", "force", "moment")}
        one = ARM.new("arm_wrench", axes=AXES.index(wrench.axes), **vectors)
        if self.core.arm_set_external_wrench(self.machine, joint, one) == REFUSED:
            raise self._refusal(where, "another one")

    @property
    def external_wrenches(self) -> dict[str, ExternalWrench]:
        """What acts on the link of each joint, by its name; empty in a scene without."""
        wrenches = {}
        for index, joint in enumerate(self.scene.chain.joints):
            if self.scene.external_wrench:
                one = ARM.new("arm_wrench")
                self.core.arm_get_external_wrench(self.machine, index, one)
                force, moment, point = map(tuple, (one.force, one.moment, one.point))
                wrenches[joint.link] = ExternalWrench(force, moment, point, AXES[one.axes])
        return wrenches

    def save(self) -> bytes:
        """Return all that decides how the machine goes on, as bytes that may be kept."""
        size = self.core.arm_saved_size()
        saved = np.zeros(size, np.uint8)
        self.core.arm_save(self.machine, pointer(saved), size)
        return saved.tobytes()

    def restore(self, saved: bytes) -> None:
        """Continue from what `save` of a plant of the same scene has returned, to the last bit.

        Raises:
            Refusal: it is of another scene, core, step or servo period, or it was spoiled; nothing
                has changed.
        """
        if self.core.arm_restore(self.machine, saved, len(saved)) == REFUSED:
            raise self._refusal("Plant.restore", "another one")

    @property
    def diverged(self) -> Diverged | None:
        """Why the machine stays where it is; None if it goes on."""
        diverged = self._look(self._clock).fault >= 0
        return self._diverged(self._measured["voltage"]) if diverged else None

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
        rows = np.atleast_2d(as_numbers(voltages, "Plant.run", "voltages", "V"))
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
            pointers = pointer(some), len(some), steps, pointer(q[first:])
            if self.core.arm_run(self.machine, *pointers) == DIVERGED:
                done = int((self.t - began) / (max(1, steps) * self.scene.integrator.dt) + 1e-6)
                raise self._diverged(some[min(done, len(some) - 1)])
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
        applied = np.array(self._voltage if voltage is None else voltage)
        values = self.parameters
        varied = tuple(replace(one, value=values[one.name]) for one in self.scene.varied)
        scene = replace(self.scene, varied=varied)
        return Diverged(scene.joint_names[joint], t, scene, q, v, applied, self._reset_to)

    def _diverged(self, voltage: ArrayLike) -> Diverged:
        state = self.state
        return self.fault(self._truth.fault, state.t, state.q, state.v, voltage)

    def _refusal(self, where: str, otherwise: str) -> Refusal:
        """Return why the core has refused a call."""
        why = ARM.new("arm_refusal")
        self.core.arm_why(self.machine, why)
        joint = f" of {self.scene.joint_names[why.joint]}" if why.joint >= 0 else ""
        got = why.got if why.joint >= 0 else otherwise
        quantity, rule = text(why.quantity), text(why.rule)
        return Refusal(where, f"{quantity}{joint}", rule, got)

    @property
    def t(self) -> float:
        """Logical time [s]."""
        return float(self._look(self._clock).time)

    @property
    def energy(self) -> float:
        """Kinetic, potential, elastic and magnetic energy [J]; potential is 0 at the base link."""
        self._look(self._energy_alone)
        return float(self._energy[0])

    def powers(self, voltage: ArrayLike) -> EnergyFlow:
        """Return what the joints are given and dissipate now, under voltages (N,) [V], in W.

        Raises:
            Refusal: wrong shape, not finite, or the scene has no `energy_flow`.
        """
        V, out = self._vector(voltage, "Plant.powers", "voltage", "V"), np.zeros((2, self._N))
        if self.core.arm_powers(self.machine, pointer(V), pointer(out)) == REFUSED:
            raise self._refusal("Plant.powers", "false")
        return EnergyFlow(*out)

    def advance_metered(self, voltage: ArrayLike, steps: int) -> EnergyFlow:
        """Advance as `advance` does, and return what the joints were given and dissipated, in J.

        The change of `energy` is their sum, as well as the scheme follows the equations. It takes
        several times as long.

        Raises:
            Refusal: as `advance`, or the scene has no `energy_flow`.
            Diverged: as `advance`.
        """
        where = "Plant.advance_metered"
        check_count(where, "steps", steps, 0, LARGEST_STEPS)
        self._voltage[:] = self._vector(voltage, where, "voltage", "V")
        total = np.zeros((2, self._N))
        for first in range(0, steps, PIECE):
            out, count = np.zeros((2, self._N)), min(PIECE, steps - first)
            meter, applied = self.core.arm_advance_metered, self._voltage_pointer
            result = meter(self.machine, applied, count, pointer(out))
            if result == REFUSED:
                raise self._refusal(where, "false")
            if result == DIVERGED:
                raise self._diverged(self._voltage)
            total += out
        return EnergyFlow(*total)

    @property
    def state(self) -> PlantState:
        """The state now, as a copy. It can be set: its time, torques and counts are not read.

        A motor behind a rigid gear turns with its link, and a joint without a motor has no current.
        The scheme begins with no past; time goes on.

        Raises:
            Refusal: wrong shapes, not finite, too large, or a motor that contradicts its link;
                nothing has changed.
        """
        self._look(self._truth)
        self.core.arm_measure(self.machine, self.measurement)
        current, theta_m, omega_m, q, v, gear_torque = self._rows.copy()
        counts = self._measured["encoder"].copy()
        t = self._truth.time
        return PlantState(t, current, theta_m, omega_m, q, v, gear_torque, counts)

    @state.setter
    def state(self, state: PlantState) -> None:
        self.put("Plant.state", {name: getattr(state, name) for name in SET})

    def put(self, where: str, given: Mapping[str, ArrayLike]) -> None:
        """Set some quantities of the state, see `state`; all others stay as they are.

        Args:
            where: name for refusals.
            given: (N,) each, by names of `PlantState`: current, theta_m, omega_m, q, v. A motor
                behind a rigid gear comes along with its link if it is not given.

        Raises:
            Refusal: as setting `state`.
        """
        rows = {}
        for name, values in given.items():
            bound = self.bounds[name]
            rows[name] = np.ascontiguousarray(bound.vector(where, values, self._N))
        if self.core.arm_set_truth(self.machine, truth_at(**rows)) == REFUSED:
            raise self._refusal(where, "another one")

    @property
    def winding_temperatures(self) -> Array:
        """Of the motors' windings (N,) [degC]; NaN where the scene tells of none."""
        temperatures = np.empty(self._N)
        self.core.arm_get_winding_temperatures(self.machine, pointer(temperatures))
        return temperatures

    @property
    def overheated(self) -> NDArray[np.bool_]:
        """Whether each drive reports that its winding is beyond its limit (N,).

        `exchange` then takes the command as 0 and closes the brake.
        """
        self.core.arm_measure(self.machine, self.measurement)
        hot: NDArray[np.bool_] = (self._measured["faults"] & FAULT_THERMAL) != 0
        return hot

    def _look(self, truth: CData) -> CData:
        """Have what has a place in `truth` written there."""
        self.core.arm_get_truth(self.machine, truth)
        return truth

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
            array = as_numbers(values, where, quantity, unit)
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
        self.core.arm_forward_dynamics(self.machine, a.size // self._N, *map(pointer, (*rows, a)))
        if not np.isfinite(a).all():
            raise Refusal(where, "what v and tau lead to", "be finite [rad/s2 or m/s2]", a)
        return a

    def linear_drives(self, loaded: bool = False) -> list[LinearDrive]:
        """Return what each joint's drive is for small motions, base to tool.

        Args:
            loaded: whether a tooth is in contact in gears with play.
        """
        K = self.core.arm_linear_drives(self.machine, loaded, NULL)
        numbers = np.zeros((self._N, 2 + K + (K + 3) * (K + 3)))
        self.core.arm_linear_drives(self.machine, loaded, pointer(numbers))
        drives = []
        for row in numbers:
            n, D, rows = int(row[0]), row[2 : 2 + K], row[2 + K :].reshape(K + 3, K + 3)
            rows = rows[:, [*range(n), K, K + 1, K + 2]]
            G, current, motor_angle = rows[K:]
            drives.append(LinearDrive(D[:n], rows[:n], G, float(row[1]), current, motor_angle))
        return drives

    def _vector(self, values: ArrayLike, where: str, quantity: str, unit: str) -> Array:
        array = as_numbers(values, where, quantity, unit)
        if array.shape != (self._N,):
            raise Refusal(where, quantity, f"have shape ({self._N},)", array.shape)
        if not np.isfinite(array).all():
            raise Refusal(where, quantity, f"be finite [{unit}]", array)
        return array


def truth_at(**places: NDArray[Any]) -> CData:
    """Return an ``arm_truth`` whose numbers go to arrays, by their names in `PlantState`."""
    return ARM.new("arm_truth", **{PLACES.get(name, name): at for name, at in places.items()})


def commands_of(scene: Scene) -> NDArray[Any]:
    """Return commands of 0, as the joints' motors take them."""
    commands = ARM.rows("arm_joint_command", len(scene.joints))
    commands["mode"] = [MODES[joint.command] for joint in scene.joints]
    commands["enable"] = 1
    return commands


def options_of(scene: Scene, values: Array) -> CData:
    """Return what the core makes machines of; `values` of the varied numbers must outlive it."""
    return ARM.new(
        "arm_options",
        core=scene.cores[1],
        step=scene.integrator.dt,
        steps_per_period=scene.steps_per_period,
        parameters=values,
    )


def link_angle_per_count(scene: Scene) -> Array:
    """Return what one encoder count means at the link (N,) [rad or m]."""
    return np.array(
        [2.0 * math.pi / joint.counts_per_turn * joint.gear.ratio for joint in scene.joints]
    )


def largest_position(scene: Scene) -> Array:
    """Return how far a link may be (N,) [rad or m], so that its encoder's counts are exact."""
    return np.minimum(POSITION.largest, LARGEST_COUNT * np.abs(link_angle_per_count(scene)))


def check_start(where: str, scene: Scene, q: Array, v: Array) -> None:
    """Refuse positions and speeds, rows of (N,), at which no motion can begin.

    Raises:
        Refusal: see above.
    """
    largest = largest_position(scene)
    if (np.abs(q) > largest).any():
        raise Refusal(where, "q", f"be at most {largest.min():g} rad or m", q)
    if (np.abs(v) > VELOCITY.largest).any():
        raise Refusal(where, "v", f"be at most {VELOCITY.largest:g} rad/s or m/s", v)


def as_numbers(values: ArrayLike, where: str, quantity: str, unit: str) -> Array:
    """Return `values` as numbers, row by row; a copy only where they are something else."""
    try:
        array = np.asarray(values)
        return array.astype(np.float64, order="C", casting="same_kind", copy=False)
    except (TypeError, ValueError):
        raise Refusal(where, quantity, f"be numbers [{unit}]", values) from None
