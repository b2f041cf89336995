"""One machine of a compiled core: all that is asked of it and set between its steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.synchronized import Synchronized, synchronized
from arm_emulator.base.validation.coerce import coerce_flag
from arm_emulator.machine.plant.call_arguments import build_refusal, make_options, make_truth
from arm_emulator.machine.plant.compiler import load_equations, load_machine
from arm_emulator.machine.plant.core_calls import ARM, REFUSED
from arm_emulator.machine.plant.external_wrench import (
    AXES,
    NUMBERS,
    ExternalWrench,
    move_to_moving_link,
)
from arm_emulator.machine.plant.plant_state import ROWS, SET, PlantState, bound_state
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.varied import find_varied
from arm_emulator.toolchain.c_header import NULL, CData, Library, make_pointer


@dataclass(frozen=True)
class BorrowedMachine:
    """A machine that belongs to a `Fleet`."""

    owner: Synchronized
    core: Library
    machine: CData


class CoreMachine(Synchronized):
    """A machine as the core keeps it: its numbers, its true state, what acts on it from outside.

    How it goes on under commands is `Plant`'s.

    Attributes:
        scene: the machine.
        bounds: how large what is set may be, by its name in `PlantState`.
        core: the compiled core (core/boundary/arm.h).
        machine: the core's handle of this machine.

    Args:
        scene: the machine.
        of: a machine of this scene that belongs to a fleet; None: a new one.
        core: its compiled core with something beside it, see `compiler.load_machine_with`.

    Raises:
        Refusal: the scene's core cannot be compiled.
    """

    def __init__(self, scene: Scene, of: BorrowedMachine | None, core: Library | None) -> None:
        super().__init__(of.owner if of else None)
        self.scene = scene
        self.core = of.core if of else core or load_machine(scene)
        self._N = N = len(scene.joints)
        self._places = scene.joint_places  # of these among the joints of the machine
        self._of_machine = len(scene.chain.shafts)
        self._owner = of.owner if of else None  # it must not go before
        self.machine = of.machine if of else self._make_machine()
        self._rows = np.zeros((len(ROWS), N))
        self._energy = np.zeros(1)
        # Separate requests: quantities without an output array are not computed.
        self._clock = make_truth()
        self._energy_alone = make_truth(energy=self._energy)
        self._truth = make_truth(**dict(zip(ROWS, self._rows, strict=True)))
        self.bounds = bound_state(scene)

    def _make_machine(self) -> CData:
        values = np.array([number.value for number in self.scene.varied], np.float64)
        return self.core.arm_new(make_options(self.scene, values))

    def __del__(self) -> None:
        machine, self.machine = getattr(self, "machine", NULL), NULL
        if machine and self._owner is None:
            self.core.arm_delete(machine)

    def restart_threads(self) -> None:  # noqa: D102
        self.core.arm_begin_threads(self.machine)

    def call_equation(self, name: str, *arguments: Any) -> Any:
        """Call a function of core/boundary/equations.h at the machine's numbers and state now.

        The first call compiles the scene's equations.

        Args:
            name: the function.
            arguments: of it, behind the point.

        Raises:
            Refusal: they cannot be compiled.
        """
        library, point = self._equations
        with self.turn:
            self.core.arm_get_point(self.machine, point)
            return getattr(library, name)(point, *arguments)

    @cached_property
    def _equations(self) -> tuple[Library, CData]:
        """The equations, and the place of the point at which they are taken."""
        size = self.core.arm_get_point(self.machine, NULL)
        return load_equations(self.scene), ARM.ffi.new("double[]", size)

    @property
    @synchronized
    def parameters(self) -> dict[str, float]:
        """The numbers that the scene lists as varied, by name, with this machine's values."""
        return {number.name: self._get_parameter(number.name) for number in self.scene.varied}

    @synchronized
    def set_parameter(self, name: str, value: float) -> None:
        """Set a varied number; the motion goes on from where it is. A reset leaves it as it is.

        Raises:
            Refusal: the scene does not list it as varied, or a value out of its range.
        """
        where = "Plant.set_parameter"
        number = find_varied(self.scene.varied, name, where)
        taken = number.number.check_value(where, value)
        if self.core.arm_set_parameter(self.machine, name.encode(), taken) == REFUSED:
            raise self._make_refusal(where, "another value")

    def _get_parameter(self, name: str) -> float:
        value = np.zeros(1)
        self.core.arm_get_parameter(self.machine, name.encode(), make_pointer(value))
        return float(value[0])

    @synchronized
    def set_external_wrench(self, link: str, wrench: ExternalWrench) -> None:
        """Let a force and a moment act on a link, until set anew or reset.

        There is one wrench per joint that moves, the one set last.

        Args:
            link: any link of the URDF that moves; the wrench is about a point of it.
            wrench: what acts.

        Raises:
            Refusal: the scene has no `external_wrench`, no such link, or numbers that are not
                finite or too large; nothing has changed.
        """
        where = "Plant.set_external_wrench"
        place, wrench = move_to_moving_link(self.scene, where, link, wrench)
        vectors = {name: getattr(wrench, name) for name in ("point", "force", "moment")}
        raw = ARM.make_struct("arm_wrench", axes=AXES.index(wrench.axes), **vectors)
        if self.core.arm_set_external_wrench(self.machine, place, raw) == REFUSED:
            raise self._make_refusal(where, "another one")

    @property
    @synchronized
    def external_wrenches(self) -> dict[str, ExternalWrench]:
        """External wrench on each link that a joint moves, by name; empty in a scene without."""
        wrenches = {}
        for place, moved in self.scene.chain.bodies.items():
            if self.scene.external_wrench:
                raw = ARM.make_struct("arm_wrench")
                self.core.arm_get_external_wrench(self.machine, place, raw)
                force, moment, point = map(tuple, (raw.force, raw.moment, raw.point))
                wrenches[moved.link] = ExternalWrench(force, moment, point, AXES[raw.axes])
        return wrenches

    @synchronized
    def save(self) -> bytes:
        """Return all that decides how the machine goes on, as bytes that may be kept."""
        size = self.core.arm_saved_size()
        saved = np.zeros(size, np.uint8)
        self.core.arm_save(self.machine, make_pointer(saved), size)
        return saved.tobytes()

    @synchronized
    def restore(self, saved: bytes) -> None:
        """Continue from what `save` of a plant of the same scene has returned, to the last bit.

        Raises:
            Refusal: it is of another scene, core, step or servo period, or it was spoiled; nothing
                has changed.
        """
        if not isinstance(saved, bytes | bytearray | memoryview):
            raise Refusal("Plant.restore", "saved machine", "be bytes of `save`", saved)
        saved = bytes(saved)
        if self.core.arm_restore(self.machine, saved, len(saved)) == REFUSED:
            raise self._make_refusal("Plant.restore", "another one")

    @property
    @synchronized
    def t(self) -> float:
        """Logical time [s]."""
        return float(self._read_truth(self._clock).time)

    @property
    @synchronized
    def energy(self) -> float:
        """Kinetic, potential, elastic and magnetic energy [J]; potential is 0 at the base link."""
        self._read_truth(self._energy_alone)
        return float(self._energy[0])

    @property
    @synchronized
    def state(self) -> PlantState:
        """The true state now, as a copy whose arrays are read-only.

        It can be set (``plant.state = dataclasses.replace(plant.state, q=q)``): its time and
        torques are not read.

        A motor behind a rigid gear turns with its link, and a joint without a motor has no current.
        The scheme begins with no past; time goes on.

        Raises:
            Refusal: wrong shapes, not finite, too large, or a motor that contradicts its link;
                nothing has changed.
        """
        self._read_truth(self._truth)
        rows = self._rows.copy()
        rows.flags.writeable = False  # a number set in a copy would not move the machine
        current, theta_m, omega_m, q, v, gear_torque = rows
        t = self._truth.time
        return PlantState(t, current, theta_m, omega_m, q, v, gear_torque)

    @state.setter
    def state(self, state: PlantState) -> None:
        if not isinstance(state, PlantState):
            raise Refusal("Plant.state", "state", "be a PlantState", state)
        self.put("Plant.state", {name: getattr(state, name) for name in SET})

    @synchronized
    def put(self, where: str, given: Mapping[str, ArrayLike]) -> None:
        """Set some quantities of the state, see `state`; all others stay as they are.

        Args:
            where: name for refusals.
            given: (N,) each, by names of `PlantState`: current, theta_m, omega_m, q, v. A motor
                behind a rigid gear moves with its link if it is not given.

        Raises:
            Refusal: as setting `state`.
        """
        rows = {}
        if not isinstance(given, Mapping) or not given.keys() <= self.bounds.keys():
            rule, valid = "be values by names of quantities", ", ".join(self.bounds)
            raise Refusal(where, "given", rule, given, valid)
        for name, values in given.items():
            rows[name] = self.bounds[name].check_row(where, values, self._N)
        if self.core.arm_set_truth(self.machine, make_truth(**rows)) == REFUSED:
            raise self._make_refusal(where, "another one")

    @property
    @synchronized
    def machine_motion(self) -> tuple[Array, Array]:
        """Positions and speeds of `scene.machine_joints` now, deflections of bearings among them.

        Two rows, of rad and rad/s or m and m/s.
        """
        point = np.empty(self.core.arm_get_point(self.machine, NULL))
        self.core.arm_get_point(self.machine, make_pointer(point))
        inputs = len(self.scene.varied) + sum(
            joint.brake is not None for joint in self.scene.joints
        )
        if self.scene.external_wrench:
            inputs += NUMBERS * len(self.scene.chain.links)
        q, v = point[inputs:].reshape(self._of_machine, -1)[:, -2:].T.copy()
        return q, v

    @property
    @synchronized
    def winding_temperatures(self) -> Array:
        """Temperatures of the windings (N,) [degC]; NaN where the scene has no `winding`."""
        temperatures = np.empty(self._N)
        self.core.arm_get_winding_temperatures(self.machine, make_pointer(temperatures))
        return temperatures

    @property
    @synchronized
    def gear_temperatures(self) -> Array:
        """Temperatures of the gears (N,) [degC]; NaN where the scene has no `gear.thermal`."""
        temperatures = np.empty(self._N)
        self.core.arm_get_gear_temperatures(self.machine, make_pointer(temperatures))
        return temperatures

    @synchronized
    def linear_drives(self, loaded: bool = False) -> list[LinearDrive]:
        """Return the linear part of the drive of each joint of the machine, base to tool.

        Args:
            loaded: whether a tooth is in contact in gears with play.
        """
        loaded = coerce_flag(loaded, "Plant.linear_drives", "loaded")
        K = self.call_equation("arm_linear_drives", loaded, NULL)
        numbers = np.zeros((self._of_machine, 2 + K + (K + 3) * (K + 3)))
        self.call_equation("arm_linear_drives", loaded, make_pointer(numbers))
        return [LinearDrive.from_row(row, K) for row in numbers]

    def _make_refusal(self, where: str, otherwise: str) -> Refusal:
        """Return the refusal of a call."""
        return build_refusal(self.core, self.machine, self.scene, where, otherwise)

    def _read_truth(self, truth: CData) -> CData:
        """Have what has a place in `truth` written there."""
        self.core.arm_get_truth(self.machine, truth)
        return truth


@dataclass(frozen=True, eq=False)
class LinearDrive(ArrayEquality):
    """The linear part of one joint's drive, as the core states it (core/mechanics/drive.hpp).

    Of a progressive gear it is the linearisation where that is not wound up.

    With its n states z, D dz/dt = F (z, q, v, u). The torque on the link is G (z, q, v, u) less
    `carried` times the link's acceleration.
    """

    D: Array  # (n,), 0 where a state follows at once
    F: Array  # (n, n + 3)
    G: Array  # (n + 3,)
    carried: float  # kg m2, of a rotor behind a rigid gear
    current: Array  # (n + 3,), A of the motor by (z, q, v, u)
    motor_angle: Array  # (n + 3,), rad

    @classmethod
    def from_row(cls, row: Array, size: int) -> LinearDrive:
        """Return the drive from a row of ``arm_linear_drives``, with places for `size` states."""
        n, D, rows = int(row[0]), row[2 : 2 + size], row[2 + size :].reshape(size + 3, size + 3)
        rows = rows[:, [*range(n), size, size + 1, size + 2]]
        G, current, motor_angle = rows[size:]
        return cls(D[:n], rows[:n], G, float(row[1]), current, motor_angle)


@dataclass(frozen=True, eq=False)
class Equations(ArrayEquality):
    """D dz/dt = f(z, q, v, u) and dv/dt = a(z, q, v, u), with what each joint does held.

    Rows and columns are as in ``arm_linearise``: a drive may have fewer than K states.

    Attributes:
        x: z, q and v, ((K + 2) N,).
        u: commands (N,).
        states: places in x of the states of the drives, drive by drive.
        D: (K N,), 0 of what follows at once.
        by: derivatives of f, a, the motors' currents and their angles by x and u.
        value: those themselves, ((K + 3) N,).
        sticks: links that stick (N,).
    """

    x: Array
    u: Array
    states: NDArray[np.int64]
    D: Array
    by: Array
    value: Array
    sticks: NDArray[np.bool_]

    @classmethod
    def from_numbers(cls, x: Array, u: Array, numbers: Array) -> Equations:
        """Return what ``arm_linearise`` has written."""
        N = len(u)
        K, rows = len(x) // N - 2, len(x) + N
        table, D = numbers[: rows * (rows + 1)].reshape(rows, rows + 1), numbers[-(K + 2) * N :]
        sticks, counts = D[K * N :].reshape(2, N)
        states = [k * N + j for j in range(N) for k in range(int(counts[j]))]
        there = np.array(states, np.int64)
        return cls(x, u, there, D[: K * N], table[:, :-1], table[:, -1], sticks > 0.0)


@dataclass(frozen=True, eq=False)
class EnergyFlow(ArrayEquality):
    """Energy supplied to and dissipated by each joint, (N,): W now, J over a time.

    The supply and the share of the external wrench that turns this joint supply it.
    A motor with different torque and back-EMF constants gets the difference, too.
    """

    supplied: Array
    dissipated: Array  # in windings, gears and friction
