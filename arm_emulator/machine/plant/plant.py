"""The emulated machine as a plain object: commands in, states out. Without ROS.

One public class, whose methods are the calls of a machine, hence the length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.synchronized import synchronized
from arm_emulator.base.validation.bound import ANY_COMMAND, ANY_COMMANDS, ANY_STATE
from arm_emulator.base.validation.coerce import coerce_flag
from arm_emulator.base.validation.count import check_count
from arm_emulator.machine.plant.call_arguments import (
    LARGEST_STEPS,
    PIECE,
    Commands,
    make_commands,
    order_by_joint,
)
from arm_emulator.machine.plant.core_calls import ARM, DIVERGED, FAULT_THERMAL, OK, REFUSED
from arm_emulator.machine.plant.core_machine import (
    BorrowedMachine,
    CoreMachine,
    EnergyFlow,
    Equations,
)
from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.machine.plant.inputs import (
    arrange_further_rows,
    check_inputs,
    list_further_inputs,
)
from arm_emulator.machine.plant.link_dynamics import LinkDynamics
from arm_emulator.machine.plant.measured import Measured, MeasuredPlace
from arm_emulator.machine.plant.plant_state import bound_start, compute_count_angle
from arm_emulator.machine.scene.scene import Scene, coerce_scene
from arm_emulator.tick.c import TICK, tick_calls
from arm_emulator.toolchain.c_header import NULL, Library, make_pointer


class Plant(CoreMachine):
    """Motors, gears and links of one scene, stepped by the compiled core.

    `measured` has the readings of the sensors, for controllers; `state`, `energy` and all else are
    true values, for judging. `copy.copy`, `copy.deepcopy` and `pickle` make another machine in the
    same state. Threads may share a plant: their calls go one after the other. A forked child has a
    plant of its own.

    Attributes:
        scene: the machine.
        compute_count_angle: what one encoder count means at the link (N,) [rad or m].
        bounds: how large what is set may be, by its name in `PlantState`.
        core: the compiled core (core/boundary/arm.h); this and the next four are for doors in C.
        machine: the core's handle of this machine.
        command, measurement: what `exchange` hands to the core.
        ticks: ``tick_machine`` of tick/c/tick.h, by which doors in C go through servo periods.

    Args:
        scene: from `load_scene`, or what that takes: a name or a file.
        of: a machine of this scene that belongs to a fleet; None: a new one.
        core: its compiled core with something beside it, see `compiler.load_machine_with`.

    Raises:
        Refusal: the scene's core cannot be compiled.
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        *,
        of: BorrowedMachine | None = None,
        core: Library | None = None,
    ) -> None:
        scene = coerce_scene(scene, "Plant")
        super().__init__(scene, of, core)
        self._added = core is not None and of is None
        N = self._N
        self._shape = (N,)
        self._applied = np.zeros(N)
        self._applied_pointer = make_pointer(self._applied)
        self._commands = make_commands(scene)
        self._further = np.zeros((len(list_further_inputs(scene)), N))
        self._has_further = len(self._further) > 0
        places = {"joint": self._commands, "further": self._further}
        self.command = ARM.make_struct("arm_command", tick=-1, **places)
        self._place = MeasuredPlace(scene)
        self._measured = self._place.joints
        self.measurement = ARM.make_struct("arm_measurement", **self._place.arrays)
        self.ticks = TICK.make_struct(
            "tick_machine",
            joints=N,
            machine=self.machine,
            measure=self.core.arm_measure,
            exchange=self.core.arm_exchange,
            get_truth=self.core.arm_get_truth,
            period=round(scene.servo_period * 1e9),
            measurement=self.measurement,
        )
        self._exchange = tick_calls().tick_exchange
        self.link_angle_per_count = compute_count_angle(scene)
        self._start_bounds = bound_start(scene)
        if not of:
            self.reset()

    def __repr__(self) -> str:
        return f"<Plant {self.scene.name} at t = {self.t:g} s>"

    def __reduce__(self) -> tuple[Any, ...]:
        if self._added:
            rule = "be of its scene alone to be pickled"
            raise Refusal("Plant", "the machine", rule, f"{self.scene.name} with code beside it")
        return Plant, (self.scene,), self.__getstate__()

    def __copy__(self) -> Plant:
        plant = Plant(self.scene, core=self.core)
        plant.__setstate__(self.__getstate__())
        return plant

    def __deepcopy__(self, memo: dict[int, object]) -> Plant:
        return self.__copy__()

    @synchronized
    def __getstate__(self) -> tuple[Any, ...]:
        count = self.ticks.tick
        return self.save(), count, self._added, self._applied.copy(), self.commanded

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.restore(state[0])
        self.ticks.tick, self._added, self._applied[:], commands = state[1:]
        self._commands["value"], self._further[:] = commands[0], commands[1:]

    @synchronized
    def reset(self, q: ArrayLike | None = None, v: ArrayLike | None = None) -> None:
        """Set the machine to logical time 0, its motors to match the links.

        No current flows, and the gears carry no torque.

        Args:
            q: link positions (N,) [rad or m], the scene's start if None.
            v: link speeds (N,) [rad/s or m/s], zero if None.

        Raises:
            Refusal: wrong shape, not finite, or too far away to be computed with; the state is as
                before.
        """
        where, N = "Plant.reset", self._N
        of_q, of_v = self._start_bounds
        at = of_q.check_row(where, self.scene.start if q is None else q, N)
        speed = np.zeros(N) if v is None else of_v.check_row(where, v, N)
        self.ticks.tick = 0
        self.core.arm_reset(self.machine, make_pointer(at), make_pointer(speed))

    def advance(self, command: Commands, steps: int) -> None:
        """Take `steps` integration steps with the commands of the motors held.

        Args:
            command: (N,) [V, N m, A], or by names of all joints; clamped as the drives do, and 0
                without power; a joint without a motor takes no notice.
            steps: number of steps of `scene.integrator.dt`, 0 to 1e15.

        Raises:
            Refusal: wrong shape, not finite, or no such count; the state is as before.
            Diverged: the integration failed; the state is the last one within bounds.
        """
        # This is called often: what fits is not looked at twice.
        if type(steps) is not int or not 0 <= steps <= PIECE:
            steps = check_count("Plant.advance", "steps", steps, 0, LARGEST_STEPS)
        row = self._convert_command(command, "Plant.advance")
        with self.turn:
            before = self._applied.copy()
            self._applied[:] = row
            advance, machine, applied = self.core.arm_advance, self.machine, self._applied_pointer
            result = advance(machine, applied, min(steps, PIECE))
            if result == REFUSED:
                self._applied[:] = before
                raise self._make_refusal("Plant.advance", "a number")
            while result == OK and steps > PIECE:
                steps -= PIECE
                result = advance(machine, applied, min(steps, PIECE))
            if result == DIVERGED:
                raise self._describe_divergence(self._applied)

    def exchange(
        self, command: Commands, tick: int = -1, *, came: bool = False, **further: Commands
    ) -> None:
        """Go through one servo period under commands that answer a tick, -1: none.

        A command is a voltage, torque or current, as the joint's motor takes it
        (`scene.joints[k].inputs`). Commands are (N,), or by names of all joints. Further inputs of
        motors are given alike, by their names (``command_d=``), and are 0 otherwise, as all
        commands are without power. Commands that `came` are those that the drives received: faults
        of their lines leave them.

        Raises:
            Refusal: wrong shape, not finite, or an input that no motor has; nothing has changed.
            Diverged: as `advance`.
        """
        where = "Plant.exchange"
        row = self._convert_command(command, where)
        if type(tick) is not int or not -1 <= tick < 2**63:
            tick = check_count(where, "tick", tick, -1)
        if came is not False:
            came = coerce_flag(came, where, "came")
        if further:
            check_inputs(where, self.scene, further)
        rows = {
            name: self._convert_further(where, name, values) for name, values in further.items()
        }
        others = arrange_further_rows(where, self.scene, rows)
        with self.turn:
            before = self._commands.tobytes(), self._further.tobytes()  # quicker than copies
            self._commands["value"] = row
            if self._has_further:
                self._further[:] = 0.0 if others is None else others
            self.command.tick, self.command.came = tick, came
            result = self._exchange(self.ticks, self.command)
            if result == REFUSED:
                commands, inputs = before
                self._commands[:] = np.frombuffer(commands, self._commands.dtype)
                self._further[:] = np.frombuffer(inputs).reshape(self._further.shape)
                raise self._make_refusal(where, "a number")
            if result == DIVERGED:
                raise self._describe_divergence(self._measured["applied"])

    def _convert_command(self, command: Commands, where: str) -> Array:
        """Return commands (N,), however they are given."""
        if isinstance(command, np.ndarray) and command.shape == self._shape:
            if command.dtype == np.float64:
                return command
        ordered = order_by_joint(command, self.scene, where)
        row = ANY_COMMAND.check_numbers(where, ordered)
        if row.shape != self._shape:
            raise Refusal(where, "command", f"have shape {self._shape}", row.shape)
        return row

    def _convert_further(self, where: str, name: str, command: Commands) -> Array:
        return ANY_COMMAND.rename(name).check_row(
            where, order_by_joint(command, self.scene, where), self._N
        )

    def exchange_in(self, loop: Callable[[], int]) -> None:
        """Go through servo periods in a loop in C, over `ticks`.

        Args:
            loop: returns what ``tick_exchange`` returned last.

        Raises:
            Refusal: a command was refused; the machine is where it was then.
            Diverged: as `advance`.
        """
        with self.turn:
            result = loop()
            if result == REFUSED:
                raise self._make_refusal("Plant.exchange_in", "a number")
            if result == DIVERGED:
                raise self._describe_divergence(self._measured["applied"])

    def measure_time(self) -> None:
        """Measure from now on the wall time that steps take, for `spent_ns`."""
        self.core.arm_measure_time(self.machine)

    @property
    def spent_ns(self) -> int:
        """Wall time that steps have taken since `measure_time` [ns]."""
        return int(self.core.arm_spent(self.machine))

    @property
    @synchronized
    def commanded(self) -> Array:
        """The newest commands of `exchange` or `exchange_in`, and further inputs (1 + I, N)."""
        rows = np.empty((1 + len(self._further), self._N))
        rows[0], rows[1:] = self._commands["value"], self._further
        return rows

    @property
    @synchronized
    def measured(self) -> Measured:
        """Readings of the sensors at the newest tick, as a copy.

        Joints without sensors (docs/reference/parts/sensors.md) report their present values.
        """
        self.core.arm_measure(self.machine, self.measurement)
        return self._place.read_values()

    @property
    def measured_place(self) -> Measured:
        """Readings as a view of the memory into which `exchange` writes, for doors in C."""
        return self._place.make_view()

    @property
    def links(self) -> LinkDynamics:
        """Dynamics of the links alone: mass matrix, nle, inverse and forward dynamics.

        Their arrays have the joints of the machine, `scene.machine_joints`.
        """
        return LinkDynamics(self.call_equation, self._of_machine)

    @property
    @synchronized
    def powered(self) -> bool:
        """Whether the drives have power; without it every command is 0."""
        self.core.arm_measure(self.machine, self.measurement)
        return bool(self.measurement.powered)

    @powered.setter
    @synchronized
    def powered(self, on: bool) -> None:
        self.core.arm_power(self.machine, coerce_flag(on, "Plant", "powered"))

    @property
    @synchronized
    def diverged(self) -> Diverged | None:
        """Why the machine stays where it is; None if it goes on."""
        diverged = self._read_truth(self._clock).fault >= 0
        return self._describe_divergence(self._measured["applied"]) if diverged else None

    @synchronized
    def run(self, commands: ArrayLike, steps: int) -> Array:
        """Apply rows of commands one after the other, without coming back to Python in between.

        Args:
            commands: (K, N) [V, N m, A].
            steps: integration steps under each row, >= 0; with all rows at most 1e15.

        Returns:
            Link positions after each row, (K, N) [rad or m].

        Raises:
            Refusal: wrong shape, not finite, or no such count; the state is as before.
            Diverged: as `advance`.
        """
        rows = np.atleast_2d(ANY_COMMANDS.check_numbers("Plant.run", commands))
        if rows.ndim != 2 or rows.shape[1] != self._N:
            raise Refusal("Plant.run", ANY_COMMANDS.name, f"have shape (K, {self._N})", rows.shape)
        ANY_COMMANDS.check_values("Plant.run", rows)
        steps = check_count("Plant.run", "steps", steps, 0, LARGEST_STEPS // max(1, len(rows)))
        q = np.zeros_like(rows)
        if steps > PIECE:
            for row, after in zip(rows, q, strict=True):
                self.advance(row, steps)
                after[:] = self.state.q
            return q
        at_once = max(1, PIECE // max(1, steps))
        for first in range(0, len(rows), at_once):
            some, began = rows[first : first + at_once], self.t
            pointers = make_pointer(some), len(some), steps, make_pointer(q[first:])
            if self.core.arm_run(self.machine, *pointers) == DIVERGED:
                done = int((self.t - began) / (max(1, steps) * self.scene.integrator.dt) + 1e-6)
                raise self._describe_divergence(some[min(done, len(some) - 1)])
        return q

    def build_divergence(
        self, joint: int, t: float, q: Array, v: Array, applied: ArrayLike | None = None
    ) -> Diverged:
        """Return what to raise when a joint, by its index, left the bounds after the state given.

        Args:
            joint: its index.
            t: logical time of that state [s].
            q: its link positions (N,) [rad or m].
            v: its link speeds (N,) [rad/s or m/s].
            applied: commands then (N,) [V, N m, A]; None: those of the last `advance`.
        """
        final = np.array(self._applied if applied is None else applied)
        values = self.parameters
        varied = tuple(replace(number, value=values[number.name]) for number in self.scene.varied)
        scene = replace(self.scene, varied=varied)
        return Diverged(scene.joint_names[joint], t, scene, q, v, final)

    def _describe_divergence(self, applied: ArrayLike) -> Diverged:
        state = self.state
        return self.build_divergence(self._truth.fault, state.t, state.q, state.v, applied)

    @synchronized
    def powers(self, command: Commands) -> EnergyFlow:
        """Return the powers supplied and dissipated now under commands (N,) [W].

        Raises:
            Refusal: wrong shape, not finite, or the scene has no `energy_flow`.
        """
        where, out = "Plant.powers", np.zeros((2, self._N))
        u = ANY_COMMAND.check_row(where, order_by_joint(command, self.scene, where), self._N)
        if self.core.arm_powers(self.machine, make_pointer(u), make_pointer(out)) == REFUSED:
            raise self._make_refusal(where, "false")
        return EnergyFlow(*out)

    @synchronized
    def advance_metered(self, command: Commands, steps: int) -> EnergyFlow:
        """Advance as `advance` does, and return what the joints were given and dissipated, in J.

        The change of `energy` is their sum, as well as the scheme follows the equations. It takes
        several times as long.

        Raises:
            Refusal: as `advance`, or the scene has no `energy_flow`.
            Diverged: as `advance`.
        """
        where = "Plant.advance_metered"
        steps = check_count(where, "steps", steps, 0, LARGEST_STEPS)
        ordered = order_by_joint(command, self.scene, where)
        self._applied[:] = ANY_COMMAND.check_row(where, ordered, self._N)
        total = np.zeros((2, self._N))
        for first in range(0, steps, PIECE):
            out, count = np.zeros((2, self._N)), min(PIECE, steps - first)
            meter, applied = self.core.arm_advance_metered, self._applied_pointer
            result = meter(self.machine, applied, count, make_pointer(out))
            if result == REFUSED:
                raise self._make_refusal(where, "false")
            if result == DIVERGED:
                raise self._describe_divergence(self._applied)
            total += out
        return EnergyFlow(*total)

    @property
    @synchronized
    def overheated(self) -> NDArray[np.bool_]:
        """Whether each drive reports that its winding is beyond its limit (N,).

        `exchange` then takes the command as 0 and closes the brake.
        """
        self.core.arm_measure(self.machine, self.measurement)
        hot: NDArray[np.bool_] = (self._measured["faults"] & FAULT_THERMAL) != 0
        return hot

    @synchronized
    def equations(
        self,
        command: Commands,
        x: Array | None = None,
        *,
        slides: bool = False,
        follows: bool = True,
    ) -> Equations:
        """Return the machine's equations about a state, and their derivatives there.

        Their N counts the joints of the machine, `scene.machine_joints`.

        Args:
            command: (N,), or by names of all joints [V, N m, A].
            x: the state, as `Equations.x`; None: the machine's own.
            slides: without dry friction.
            follows: whether the memory of gears follows their twist first, as in a step.

        Raises:
            Refusal: wrong shape or not finite.
        """
        where, N = "Plant.equations", self._of_machine
        u = np.zeros(N)  # to be put within its bounds
        u[self._places] = ANY_COMMAND.check_row(
            where, order_by_joint(command, self.scene, where), self._N
        )
        slides = coerce_flag(slides, where, "slides")
        follows = coerce_flag(follows, where, "follows")
        size = N * (self.call_equation("arm_linear_drives", False, NULL) + 2)
        at = np.zeros(size) if x is None else ANY_STATE.check_row(where, x, size).copy()
        numbers = np.zeros((size + N) * (size + N + 1) + size)
        places = (
            make_pointer(at),
            make_pointer(u),
            x is None,
            slides,
            follows,
            make_pointer(numbers),
        )
        self.call_equation("arm_linearise", *places)
        return Equations.from_numbers(at, u, numbers)
